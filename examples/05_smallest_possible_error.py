"""How accurate could any unbiased estimator be in a condition? The Cramér-Rao bound.

.venv/bin/python examples/05_smallest_possible_error.py

What the bound assumes is in docs/accuracy.md.
"""

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.investigations.limits import bound_of
from armimp_bringup.simulated import simulate

relaxed = ExperimentConfig(duration=20.0, friction=1, resolution=1, perturbation=2)
pushing = relaxed.model_copy(update={"arm_sim": {"voluntary": {"rms": 0.3}}})
quiet, noisy = simulate([relaxed, pushing])

band = (noisy.options.welch.f_low, noisy.options.welch.f_high)
bound = bound_of(noisy, quiet, band)  # motion of the relaxed arm, noise of the pushing one
fit = noisy.identify(["lpm_full"]).estimators["lpm_full"].fit

print("element   smallest s.d.   s.e. of lpm_full   true value")
for place, letter in enumerate("MBK"):
    smallest, stated = bound[place], getattr(fit, f"{letter}_se")
    true = getattr(noisy.truth, letter)
    for i in (0, 1):
        print(
            f"{letter}{i + 1}{i + 1}       {smallest[i, i]:13.5f}   {stated[i, i]:16.5f}"
            f"   {true[i, i]:10.3f}"
        )
