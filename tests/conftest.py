"""Settings that LeRobot and its libraries read when they are imported, hence before any test module."""

import os
import tempfile

os.environ["HF_HUB_OFFLINE"] = "1"  # nothing here may reach for the Hub
os.environ["HF_LEROBOT_HOME"] = tempfile.mkdtemp(prefix="lerobot_buds_tests_")  # caches of frames and latents
os.environ.setdefault("MUJOCO_GL", "egl")
os.environ.setdefault("OMP_NUM_THREADS", "1")  # tiny tensors: threads would only wait for one another
