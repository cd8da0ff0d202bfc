"""Eq. 1 fitted by scipy, for a fit to be tested against one we did not write.

Argument: a table of displacement_mm, resistance_ohm. Prints JSON: a, b and c, each with its 95 %
interval, from ln(resistance) with the logarithms of a, b, c as unknowns; and Student's t.
"""

import json
import sys

import numpy as np
from scipy.optimize import curve_fit
from scipy.stats import t

x, resistance = np.loadtxt(
    (line for line in open(sys.argv[1]) if not line.startswith(("#", "d"))), delimiter=",", unpack=True
)


def ln_resistance(x, ln_a, ln_b, ln_c):
    """Eq. 1."""
    return np.log(np.exp(ln_a) / np.expm1(np.exp(ln_b) * x) + np.exp(ln_c))


start = [np.log(1e8), 0.0, np.log(1e6)]
found, covariance = curve_fit(
    ln_resistance, x, np.log(resistance), p0=start, xtol=1e-14, ftol=1e-14, gtol=1e-14
)
half = t.ppf(0.975, len(x) - 3) * np.sqrt(np.diag(covariance))
fitted = np.exp(np.stack([found, found - half, found + half], axis=1))
quantiles = [(freedom, t.ppf(0.975, freedom)) for freedom in (1, 2, 3, 5, 17, 57, 1000)]
json.dump({"fitted": fitted.tolist(), "t_95": quantiles}, sys.stdout)
