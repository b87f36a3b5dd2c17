"""What statistics give, as data: analyses of variance and paired tests."""

from __future__ import annotations

from dataclasses import dataclass

LEVEL = 0.05
"""Largest p that counts as significant."""


@dataclass(frozen=True, kw_only=True)
class Anova:
    """A repeated-measures analysis of variance, degrees of freedom and p by Greenhouse and Geisser's correction."""

    effect: str
    """What differs: a column, or two joined by " * " for their interaction."""
    statistic: float
    """F."""
    df_effect: float
    """Degrees of freedom of the effect, times epsilon."""
    df_error: float
    """Degrees of freedom of the error, times epsilon."""
    p: float
    """Probability of so large an F without an effect, corrected."""
    epsilon: float
    """Greenhouse and Geisser's epsilon, 1 where all differences vary alike."""
    effect_size: float
    """Generalised eta squared, the share of variance that the effect explains [1]."""

    def __str__(self) -> str:
        """Write it as papers do."""
        return (f"F({self.df_effect:.3f}, {self.df_error:.1f}) = {self.statistic:.3f}, {p_text(self.p)}, "
                f"generalised eta² = {self.effect_size:.3f}")


@dataclass(frozen=True, kw_only=True)
class PairedTest:
    """One method beside another over the same people: first less second."""

    first: str
    """The one method."""
    second: str
    """The other."""
    people: int
    """Pairs."""
    mean: float
    """Mean difference, in the measured unit; negative: the first has less."""
    interval: tuple[float, float]
    """95 % bootstrap interval of the mean difference (bias-corrected and accelerated)."""
    statistic: float
    """Student's t of the differences."""
    p: float
    """Two-sided probability, corrected for all tests of the family (Holm)."""
    effect_size: float
    """Hedges' g for paired data, the mean difference in average standard deviations [1]."""
    p_ranks: float
    """Probability by Wilcoxon's signed ranks, which needs no normal differences; corrected likewise."""

    @property
    def less(self) -> bool:
        """True if the first has significantly less than the second."""
        return self.p < LEVEL and self.mean < 0.0

    @property
    def alike(self) -> bool:
        """True if no significant difference was found; how large one may be, the interval says."""
        return not self.p < LEVEL

    def __str__(self) -> str:
        """Write it as papers do."""
        low, high = self.interval
        return (f"{self.first} less {self.second}: {self.mean:+.4g} [{low:+.4g}, {high:+.4g}], t({self.people - 1}) = "
                f"{self.statistic:.2f}, {p_text(self.p)}, g = {self.effect_size:.2f}")


def p_text(p: float) -> str:
    """Write a probability as papers do."""
    return "p < 0.001" if p < 0.001 else f"p = {p:.3f}"
