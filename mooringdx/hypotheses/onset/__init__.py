"""Parts of the onset bank, `mooringdx.hypotheses.onset_glr`: its loops, its clock and odds, and its events."""
