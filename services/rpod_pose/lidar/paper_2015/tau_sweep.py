"""Choice of tau for the fast variant of template matching: success against templates left out.

Source: Opromolla et al., Sensors 15(3), 2015, section 2.2 and Eq. 3. A larger tau leaves fewer templates out;
the paper takes 0.1.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from rpod_pose.lidar.paper_2015.template_matching import Comparison
from rpod_schemas.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class TauSweep:
    """Results of the fast variant for several values of tau."""

    taus: FloatArray
    """Values of tau, shape (L,)."""
    success_share: FloatArray
    """Share of the scans whose best template among the kept ones succeeds, shape (L,)."""
    excluded_share: FloatArray
    """Share of the templates that are left out, mean over the scans, shape (L,)."""
    plain_success_share: float
    """Share of the scans that succeed if no template is left out."""

    def smallest_tau(self, loss: float) -> float:
        """Return the least tau at which, as at all larger ones, at most a share ``loss`` of scans is lost.

        It is inf if there is none.
        """
        enough = self.success_share >= self.plain_success_share - loss
        first = len(enough) - int(np.logical_and.accumulate(enough[::-1]).sum())
        return float(self.taus[first]) if first < len(enough) else float("inf")


def sweep_tau(
    comparisons: Sequence[Comparison], succeeds: Callable[[int, int], bool], taus: FloatArray
) -> TauSweep:
    """Return success and templates left out as functions of tau.

    Args:
        comparisons: comparisons of each scan with all templates, by the plain variant; at least one.
        succeeds: function of the indices of scan and template: whether it leads to the true pose; called once
            a pair.
        taus: ascending, shape (L,).
    """
    succeeds = cache(succeeds)
    success, excluded = np.zeros((len(comparisons), len(taus))), np.zeros((len(comparisons), len(taus)))
    plain = np.zeros(len(comparisons))
    for scan, compared in enumerate(comparisons):
        plain[scan] = _best_succeeds(scan, compared.costs_m2, succeeds)
        for limit, tau in enumerate(taus.tolist()):
            kept = compared.spread_differences <= tau  # false for NaN
            success[scan, limit] = _best_succeeds(scan, np.where(kept, compared.costs_m2, np.inf), succeeds)
            excluded[scan, limit] = 1.0 - kept.mean()
    return TauSweep(taus, success.mean(axis=0), excluded.mean(axis=0), float(plain.mean()))


def _best_succeeds(scan: int, costs_m2: FloatArray, succeeds: Callable[[int, int], bool]) -> bool:
    best = int(np.argmin(costs_m2))
    return bool(np.isfinite(costs_m2[best])) and succeeds(scan, best)
