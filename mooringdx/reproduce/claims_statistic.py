"""What [Fang2015, sections 3.1 and 3.2] says of the statistic and its threshold, and what they say here."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mooringdx.config import rate_text
from mooringdx.plots.whiteness import autocorrelation
from mooringdx.reproduce.effects import BENT, Claim, grade, weibull_distance
from mooringdx.reproduce.study import WINDOWS, Repeat, Study


def statistic_correlated(study: Study) -> Claim:
    """Judge "the test statistics are clearly correlated"."""
    numbers: dict[str, float] = {}
    words, good = [], []
    for c in study.courses:
        rho = autocorrelation(c.quiet, c.window)
        lag = int(np.argmax(rho < 0.5))
        numbers[f"lag_m{c.window}"] = float(lag)
        words.append(f"M = {c.window}: autocorrelation above 0.5 up to {lag * study.sample_time:.1f} s apart")
        good.append(lag > 10)
    said = "The test statistics are clearly correlated; the IID assumption is not fulfilled."
    note = ". Windows overlap, so they must be: white z would give (1 - lag/M)^2, above 0.5 up to 0.29 M."
    rule = "autocorrelation above 0.5 over more than 10 samples"
    return Claim("3.2, Fig. 8", said, "; ".join(words) + note, rule, grade(*good), numbers)


def weibull_law(study: Study) -> Claim:
    """Judge "approximated quite well with a Weibull distribution"."""
    numbers: dict[str, float] = {}
    words, good = [], []
    for c in study.courses:
        d = weibull_distance(c)
        numbers |= {f"distance_m{c.window}": d, f"shape_m{c.window}": c.shape, f"scale_m{c.window}": c.scale}
        words.append(f"M = {c.window}: D {d:.3f}, shape {c.shape:.2f}, scale {c.scale:.2g}")
        good.append(d < BENT)
    said = "The distribution of the test statistics is approximated quite well with a Weibull distribution."
    return Claim("3.2, Fig. 8", said, "; ".join(words) + ".", f"D below {BENT} at both windows", grade(*good), numbers)


def threshold_rate(study: Study) -> Claim:
    """Judge the step from a probability a sample to a threshold: which rate does the Weibull level give?"""
    numbers: dict[str, float] = {"asked_rate": study.asked}
    words, good = [], []
    for c in study.courses:
        numbers |= {
            f"level_m{c.window}": c.level,
            f"ideal_level_m{c.window}": c.ideal_level,
            f"P_m{c.window}": c.probability,
        }
        numbers |= {f"cluster_m{c.window}": c.cluster, f"rate_m{c.window}": c.weibull_rate}
        ratio = c.weibull_rate * len(study.rivals) / study.asked
        words.append(
            f"M = {c.window}: asked {rate_text(study.asked)}, that is P = {c.probability:.1e} a sample with clusters "
            f"of {c.cluster:.0f} samples; level {c.level:.3g} by the Weibull law, {c.ideal_level:.3g} by that of "
            f"Gaussian means of the same variance, by which the first would give {ratio:.1e} of the asked rate"
        )
        good.append(1 / 3 <= ratio <= 3.0)
    said = "The threshold for a desired false alarm probability is obtained from the Weibull law (eqs. 20 to 22)."
    rule = "both laws give the same rate within a factor of 3"
    return Claim("3.2, eqs. 20-22", said, "; ".join(words) + ".", rule, grade(*good), numbers)


def gaussian_theory(study: Study) -> Claim:
    """Judge "asymptotic theory, with a window size reasonable for implementation (150 samples)"."""
    numbers: dict[str, float] = {}
    words, good = [], []
    for c in study.courses:
        mean = 2.0 * float(c.quiet.mean())
        numbers[f"twice_mean_m{c.window}"] = mean
        words.append(f"M = {c.window}: mean of 2 g {mean:.2f}, where theory for white z has 1")
        good.append(0.8 < mean < 1.25)
    said = "The statistics of a GLRT on Gaussian signals exist as asymptotic expressions, with a window of 150 samples."
    note = (
        ". It need not be 1: the spectrum near zero, which sets window means, is what a whitening filter knows least."
    )
    return Claim("3.2", said, "; ".join(words) + note, "mean of 2 g within 0.8 to 1.25", grade(*good), numbers)


def sharp_change(study: Study) -> Claim:
    """Judge "at t = 580, the test statistics is changed sharply"."""
    numbers: dict[str, float] = {}
    words, good = [], []
    for c in study.courses:
        delay = np.nan if c.alarm is None else c.alarm - study.onset
        numbers |= {f"delay_m{c.window}": delay, f"false_m{c.window}": float(c.before)}
        said = "never" if c.alarm is None else f"{delay:.1f} s after the fault"
        words.append(f"M = {c.window}: level passed {said}; samples above it before the fault: {c.before}")
        good.append(c.alarm is not None and delay <= c.window * study.sample_time and c.before == 0)
    found = [e for e in study.detection.events if e.detected >= study.onset]
    early = len(study.detection.events) - len(found)
    note = f"; this program's own chain on all residuals: {early} alarms before the fault, and after it "
    if found:
        note += (
            f"{found[0].kind.replace('_', ' ')} {found[0].subject} found {found[0].detected - study.onset:.1f} s late."
        )
    else:
        note += "none."
    claim = f"At t = {study.onset:g} s the test statistic is changed sharply."
    rule = "passed within one window, and never before the fault"
    return Claim("3.2, Fig. 8", claim, "; ".join(words) + note, rule, grade(*good), numbers)


def named(study: Study) -> Claim:
    """Judge isolation by the largest of the lines' statistics (eq. 19)."""
    first, second = sorted(study.rivals, key=lambda line: -study.rivals[line])[:2]
    words = (
        f"One window after the fault (M = {WINDOWS[-1]}) the largest g is that of {first.replace('_', ' ')}, "
        f"{study.rivals[first]:.3g}; the next, of {second.replace('_', ' ')}, is {study.rivals[second]:.3g}."
    )
    said = "Parallel vector detectors isolate the faulty line as that of the largest statistic."
    rule = "the largest is that of the faulty line"
    return Claim("3.1, eq. 19", said, words, rule, grade(first == study.line), dict(study.rivals))


def again(repeats: Sequence[Repeat]) -> Claim:
    """Judge the sharp change and the isolation on further records, which the paper does not have."""
    numbers: dict[str, float] = {"records": float(len(repeats)), "named": float(sum(r.named for r in repeats))}
    words = []
    for i, window in enumerate(WINDOWS):
        delays = [r.delays[i] for r in repeats if r.delays[i] is not None]
        late = np.array([d for d in delays if d is not None])
        false = sum(r.before[i] > 0 for r in repeats)
        numbers |= {f"found_m{window}": float(late.size), f"false_m{window}": float(false)}
        spread = "never found" if not late.size else f"median {np.median(late):.1f} s, last {late.max():.1f} s"
        if late.size:
            numbers |= {f"delay_median_m{window}": float(np.median(late)), f"delay_last_m{window}": float(late.max())}
        words.append(
            f"M = {window}: {late.size} of {len(repeats)} found ({spread}), {false} with an alarm before the fault"
        )
    words.append(f"line named one window after: {numbers['named']:.0f} of {len(repeats)}")
    good = [numbers[f"found_m{m}"] == len(repeats) and numbers[f"false_m{m}"] == 0 for m in WINDOWS]
    said = "(One record in the paper.) The change is sharp, and the line is isolated."
    rule = "found in every record, no alarm before the fault, the right line in every record"
    return Claim(
        "3.1, 3.2", said, "; ".join(words) + ".", rule, grade(*good, numbers["named"] == len(repeats)), numbers
    )


def enough_data(study: Study) -> Claim:
    """Judge whether the no-fault window carries a "very low" probability."""
    seconds = study.window[1] - study.window[0]
    numbers = {"seconds": seconds, "times": 1.0 / (study.asked * seconds)}
    numbers |= {f"windows_m{c.window}": seconds / study.sample_time / c.window for c in study.courses}
    windows = " and ".join(f"{numbers[f'windows_m{c.window}']:.1f} (M = {c.window})" for c in study.courses)
    verdict = study.baseline.verdict
    trend = [s.trend[0] * seconds / float(np.nanstd(s.raw[study.quiet])) for s in (study.force, study.tension)]
    numbers |= {"r1_trend_sd": trend[0], "r5_trend_sd": trend[1]}
    words = (
        f"The no-fault window of {seconds:g} s holds {windows} windows, and the asked rate is one alarm in "
        f"{numbers['times']:.0f} such records: this program's verdict on the rate is '{verdict}'. The current grows "
        f"inside the window; over it r1, which no current meter corrects, runs by {trend[0]:+.2f} and r5 by "
        f"{trend[1]:+.2f} of its sd."
    )
    rule = "40 windows or more, and the rate within 10 records"
    said = "The false alarm probability is set to a very low value, learned from data on [180, 550] s."
    good = verdict == "supported"
    return Claim("3.2", said, words, rule, grade(good), numbers)
