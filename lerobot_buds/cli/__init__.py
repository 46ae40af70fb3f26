"""One thin module per command."""

import os

# Read by torch's thread library when it is loaded. Threads that spin while they wait made training several times slower
# beside other work (docs/performance.md).
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
