"""The reports of a training run, and what follows from them: which network is kept, and when training ends."""

from collections.abc import Sequence

Report = dict[str, float]
"""``step``, and the loss terms as ``training/<name>`` and, where episodes are held out, ``validation/<name>``."""


def kept_report(losses: Sequence[Report]) -> int:
    """Tells whose network is kept: that of the lowest validation loss, the earliest of several; else the last.

    Not the last in any case: under early stopping those after the lowest are worse by definition, and the rate that
    falls to zero makes the last of an unbroken run the lowest anyway, unless it overfits.

    Args:
        losses: All reports so far, at least one.

    Returns:
        Its index.
    """
    if "validation/loss" not in losses[-1]:
        return len(losses) - 1
    return min(range(len(losses)), key=lambda i: losses[i]["validation/loss"])


def out_of_patience(losses: Sequence[Report], patience: int) -> bool:
    """Tells whether the last `patience` reports brought no new lowest validation loss; never where it is 0.

    Args:
        losses: All reports so far.
        patience: Number of reports.
    """
    return 0 < patience < len(losses) - kept_report(losses) if losses else False
