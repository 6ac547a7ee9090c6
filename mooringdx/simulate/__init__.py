"""Make a log with a known fault: the smallest honest simulator of a moored vessel.

The only room with randomness: everything else in the package gives the same answer to the same log.
"""

from mooringdx.simulate.record import save_log, simulate
from mooringdx.simulate.scenario import Scenario, load_scenario

__all__ = ["Scenario", "load_scenario", "save_log", "simulate"]
