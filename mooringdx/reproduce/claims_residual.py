"""What [Fang2015, sections 2.2 and 2.3] says of the residuals, raw, whitened and compressed, and what they say here."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np

from mooringdx.plots.whiteness import autocorrelation
from mooringdx.reproduce.effects import BENT, CLOSE, Claim, gaussian_distance, grade, kurtosis, wave_share
from mooringdx.reproduce.study import Series, Study
from mooringdx.types import Array
from mooringdx.whiten.compress import fit_compression
from mooringdx.whiten.whiteness import Whiteness, whiteness


def _white(study: Study, values: Array) -> Whiteness:
    return whiteness([values[study.quiet]], lags=20)


def raw_gaussian(study: Study, pair: tuple[Series, ...]) -> Claim:
    """Judge "amplitude distributions before and after the fault are reasonably close to being Gaussian"."""
    numbers: dict[str, float] = {}
    words, good = [], []
    for s in pair:
        for name, mask in (("before", study.quiet), ("after", study.late)):
            d, k = gaussian_distance(s.raw[mask]), kurtosis(s.raw[mask])
            numbers |= {f"{s.symbol}_{name}_distance": d, f"{s.symbol}_{name}_kurtosis": k}
            words.append(f"{s.symbol} {name}: D {d:.3f}, excess kurtosis {k:+.2f}")
            good.append(d < BENT and abs(k) < 0.5)
    rule = f"D below {BENT} and excess kurtosis within 0.5, of each residual before and after"
    said = "The amplitude distributions before and after the fault are reasonably close to being Gaussian."
    return Claim("2.2, Figs. 3 and 4", said, "; ".join(words) + ".", rule, grade(*good), numbers)


def raw_correlated(study: Study, pair: tuple[Series, ...]) -> Claim:
    """Judge "considerable correlation, caused by the wave impact": how much, and at which period."""
    assert study.baseline.fitted is not None
    period = study.baseline.fitted.timing.peak_period
    numbers: dict[str, float] = {"peak_period": period}
    words, good = [], []
    for s in pair:
        w = _white(study, s.raw)
        share = wave_share(s.raw[study.quiet], study.sample_time, period)
        numbers |= {
            f"{s.symbol}_max_acf": w.max_acf,
            f"{s.symbol}_ljung_box": w.ljung_box,
            f"{s.symbol}_wave_share": share,
        }
        words.append(
            f"{s.symbol}: largest |acf| {w.max_acf:.2f} in lags 1 to 20, LB/N {w.ljung_box:.2g}, "
            f"{100 * share:.0f} % of the variance in the wave band"
        )
        good += [w.max_acf > 0.3, share > 0.5]
    rule = (
        f"largest |acf| above 0.3, over half of the variance at 0.5 to 2 times the wave frequency (1/{period:.2f} Hz)"
    )
    said = "The autocorrelation functions show considerable correlation, caused by the wave impact."
    return Claim("2.2, Figs. 3 and 4", said, "; ".join(words) + ".", rule, grade(*good), numbers)


def whitened(study: Study, pair: tuple[Series, ...]) -> Claim:
    """Judge "the correlation reduces after the whitening process"."""
    numbers: dict[str, float] = {}
    words, good = [], []
    for s in pair:
        a, b = _white(study, s.raw), _white(study, s.white)
        numbers |= {f"{s.symbol}_max_acf": b.max_acf, f"{s.symbol}_ljung_box": b.ljung_box, f"{s.symbol}_p": b.p_value}
        numbers |= {f"{s.symbol}_window_ratio": b.window_ratio}
        words.append(
            f"{s.symbol}: largest |acf| {a.max_acf:.2f} to {b.max_acf:.3f}, LB/N {a.ljung_box:.2g} to "
            f"{b.ljung_box:.2g} (p {b.p_value:.2g}); variance of 15 s means {b.window_ratio:.2f} of that of white noise"
        )
        good += [b.max_acf < 0.5 * a.max_acf, b.ljung_box < 0.1 * a.ljung_box]
    rule = "largest |acf| at most half, LB/N at most a tenth of the raw one (20 lags)"
    said = "The correlation in a fault-free situation reduces after the whitening process."
    return Claim("2.3, Fig. 5", said, "; ".join(words) + ".", rule, grade(*good), numbers)


def tails(study: Study, pair: tuple[Series, ...]) -> Claim:
    """Judge "the whitened signals do not approximate the Gaussian distribution"."""
    numbers: dict[str, float] = {}
    words, good = [], []
    for s in pair:
        z = s.white[study.quiet]
        d, k = gaussian_distance(z), kurtosis(z)
        numbers |= {f"{s.symbol}_distance": d, f"{s.symbol}_kurtosis": k}
        words.append(f"{s.symbol}: D {d:.3f}, excess kurtosis {k:+.2f}")
        good.append(d > CLOSE or k > 0.5)
    said = "The whitened signals do not approximate the Gaussian distribution: both tails depart."
    note = " The sea of the simulator is Gaussian; tails come only from the lines and the drift forces."
    return Claim(
        "2.3, Fig. 6",
        said,
        "; ".join(words) + "." + note,
        f"D above {CLOSE} or excess kurtosis above 0.5",
        grade(*good),
        numbers,
    )


def compression_shape(study: Study, pair: tuple[Series, ...]) -> Claim:
    """Judge "the result of compression is a better fit to Gaussian distribution"."""
    numbers: dict[str, float] = {}
    words, good = [], []
    for s in pair:
        a, b = (gaussian_distance(x[study.quiet]) for x in (s.white, s.packed))
        k = kurtosis(s.packed[study.quiet])
        numbers |= {f"{s.symbol}_before": a, f"{s.symbol}_after": b, f"{s.symbol}_kurtosis": k}
        words.append(f"{s.symbol}: D {a:.3f} to {b:.3f}, excess kurtosis after {k:+.2f}")
        good.append(b < a)
    normal = NormalDist()
    ideal = np.array([normal.inv_cdf((i + 0.5) / 20001) for i in range(20001)])
    law = fit_compression([ideal], "fang", 3.0)
    packed = law(ideal[:, None])[:, 0]
    numbers |= {"ideal_kurtosis": kurtosis(packed), "ideal_scale": float(law.scale[0]), "uniform_kurtosis": -1.2}
    note = (
        f" Exactly Gaussian values become nearly uniform under eqs. 9 and 10: excess kurtosis {kurtosis(packed):+.2f} "
        f"(a uniform law has -1.20), D {gaussian_distance(packed):.3f}, nothing beyond {3 * float(law.scale[0]):.2f} "
        "sd. The compression bounds wild samples; it does not restore a Gaussian law."
    )
    said = "It is clear that the result of compression is a better fit to Gaussian distribution."
    return Claim(
        "2.3, Fig. 6", said, "; ".join(words) + "." + note, "D smaller after than before", grade(*good), numbers
    )


def compression_correlation(study: Study, pair: tuple[Series, ...]) -> Claim:
    """Judge "signal correlation has not changed" under compression."""
    numbers: dict[str, float] = {}
    words, good = [], []
    for s in pair:
        a, b = (autocorrelation(x[study.quiet], 150) for x in (s.white, s.packed))
        change = float(np.max(np.abs(a[1:] - b[1:])))
        numbers[f"{s.symbol}_change"] = change
        words.append(f"{s.symbol}: largest change of the acf over 15 s {change:.3f}")
        good.append(change < 0.05)
    said = "Signal correlation has not changed with the compression; the residuals are reasonably independent."
    return Claim("2.3, Fig. 7", said, "; ".join(words) + ".", "no lag changes by more than 0.05", grade(*good), numbers)


def order_of_steps(study: Study) -> Claim:
    """Compare whitening then compressing (done in the paper's figures) with the reverse (its stated procedure)."""
    o = study.orders
    words = (
        f"On {study.tension.symbol}, whitened then compressed against compressed then whitened: excess kurtosis "
        f"{o.kurtosis[0]:+.2f} and {o.kurtosis[1]:+.2f}, LB/N {o.ljung_box[0]:.2g} and {o.ljung_box[1]:.2g}, shift of "
        f"the mean in 15 s after the fault {o.contrast[0]:.1f} and {o.contrast[1]:.1f} sd of such means."
    )
    numbers = {
        f"{key}_{step}": value
        for key, both in (("kurtosis", o.kurtosis), ("ljung_box", o.ljung_box), ("contrast", o.contrast))
        for step, value in zip(("whiten_first", "compress_first"), both, strict=True)
    }
    said = "Residuals are first compressed, thereafter whitened (p. 9); the figures do it the other way (p. 7)."
    rule = "the stated order is as white (LB/N at most twice) and sees the fault as well (shift at least 0.8 times)"
    verdict = grade(o.ljung_box[1] <= 2 * o.ljung_box[0], o.contrast[1] >= 0.8 * o.contrast[0])
    return Claim("2.3", said, words, rule, verdict, numbers)


def tension_rises(study: Study) -> Claim:
    """Judge "with loss of a buoyancy element, the tension will increase", and that both residuals show it."""
    moves = {}
    for s in (study.force, study.tension):
        shift = float(np.nanmean(s.raw[study.late]) - np.nanmean(s.raw[study.quiet]))
        moves[s.symbol] = (shift, shift / float(np.nanstd(s.raw[study.quiet])))
    r1, r5 = moves["r1"], moves["r5"]
    numbers = {"r1_shift": r1[0], "r1_shift_sd": r1[1], "r5_shift": r5[0], "r5_shift_sd": r5[1]}
    words = (
        f"The residual of {study.line.replace('_', ' ')} moves by {r5[0]:+.2f} {study.tension.unit}, {r5[1]:+.1f} of "
        f"its no-fault sd; r1 by {r1[0]:+.2g} {study.force.unit}, {r1[1]:+.1f} sd, of which a part is the current, "
        "stronger after the window than in it."
    )
    said = "With loss of a buoyancy element the tension will increase; the change is strongly detectable."
    rule = "the tension residual rises by more than 3 sd, r1 moves by more than 3 sd"
    return Claim("2.1, 2.3, Figs. 3, 4", said, words, rule, grade(r5[1] > 3, abs(r1[1]) > 3), numbers)
