"""A segmentation to look at: one HTML file that asks nobody for anything.

The data flow: ``content`` reads the dataset; ``demonstrations``, ``cards`` and ``scores`` make of it what the parts of
the page show, as plain data with ``pictures``, and ``rivals`` of a comparison; ``writing`` puts it into the template in
``page``. ``viewer`` makes of the same content a recording for the rerun viewer.
"""

from .content import Content
from .rivals import rivals
from .viewer import require_rerun, write_recording
from .writing import write_report

__all__ = ["Content", "require_rerun", "rivals", "write_recording", "write_report"]
