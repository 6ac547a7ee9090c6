"""Figures: each a pure function of a stored `Detection`, in the order in which a report shows them."""

from __future__ import annotations

from mooringdx.plots import closeup, posterior, series, statistic, track, whiteness
from mooringdx.plots.canvas import Plot, paint, save

__all__ = ["FIGURES", "Plot", "paint", "save"]

FIGURES: dict[str, Plot] = {
    "event": Plot("Event from close by", "events", closeup.parts, closeup.draw, closeup.caption),
    "statistic": Plot("Statistic and threshold", "alarms", statistic.parts, statistic.draw, statistic.caption),
    "posterior": Plot("Hypotheses", "hypotheses", posterior.parts, posterior.draw, posterior.caption),
    "track": Plot("Track", "track", track.parts, track.draw, track.caption),
    "channels": Plot("Channels", "channels", series.channel_parts, series.channels, series.channel_caption),
    "residuals": Plot("Residuals", "residuals", series.residual_parts, series.residuals, series.residual_caption),
    "forces": Plot("Forces", "residuals", series.force_parts, series.forces, series.force_caption),
    "whiteness": Plot("Whiteness", "whiteness", whiteness.parts, whiteness.draw, whiteness.caption),
}
