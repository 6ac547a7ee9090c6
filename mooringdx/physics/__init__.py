"""What a textbook says of moored vessels: frames, line statics, the mooring system, waves and the ship's answer.

Nothing about faults as such: a fault is another line, which `mooringdx.physics.line` can tabulate as well.
"""
