"""One thin module per command.

It imports what its settings are made of, and what the work needs when the work begins: torch, LeRobot and scikit-learn
take seconds, for which neither ``--help`` nor the answer to a mistyped option waits (docs/performance.md).
"""

import os

# Read by torch's thread library when it is loaded. Threads that spin while they wait made training several times slower
# beside other work (docs/performance.md).
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
