"""mooringdx: what broke on a moored vessel, which line or which sensor, when, how badly, and how sure."""

__version__ = "0.1.0"
