"""A segmentation to look at: one HTML file that asks nobody for anything.

The data flow: ``content`` reads the dataset; ``demonstrations``, ``cards`` and ``scores`` make of it what the parts of
the page show, as plain data with ``pictures``; ``writing`` puts it into the template in ``page``.
"""

from .content import Content
from .writing import write_report

__all__ = ["Content", "write_report"]
