"""Trains with LeRobot's own script in two processes on one machine, without a GPU."""

import contextlib
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot.scripts import lerobot_train
from safetensors.torch import load_file

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
STEPS = 36
LAST = 12
LONGEST_RUN_S = 500
LEAVING_S = 20


@pytest.fixture(scope="session")
def long_root(record, tmp_path_factory):
    """300 frames: `STEPS` batches of 8 stay within the first epoch.

    Only there have one process with 8 and two with 4 the same frames in a step (later the last batches are filled up
    differently), and only there does LeRobot 0.6.1 resume at the frame where it stopped (later it deals out the order
    of the first epoch again).
    """
    return Path(record(tmp_path_factory.mktemp("long") / "data", repeats=10).root)


def losses(log):
    """Every logged loss of every step, by name; LeRobot logs the means over the processes."""
    lines = re.findall(r"step:\d+ .*", log)
    assert lines, log
    steps = [{name: float(value) for name, value in re.findall(r"(\w*loss):([\d.]+)", line)} for line in lines]
    return {name: np.array([step[name] for step in steps]) for name in steps[0]}


@pytest.fixture
def two_processes(tmp_path):
    """Runs the training script as a user would with ``torchrun``; returns what it logged.

    One run in a few never leaves after the end of its training (PyTorch 2.11, pytorch/pytorch#56297): freeing the
    process group waits for gloo's thread, and that for the interpreter. Nothing is lost by then; torchrun is told to
    stop.
    """
    log = tmp_path / "two_processes.log"
    launcher = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc_per_node=2"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "ACCELERATE_USE_CPU": "true"}

    def two_processes(*arguments):
        command = [*launcher, "-m", "lerobot.scripts.lerobot_train", *arguments]
        with log.open("w") as file:
            process = subprocess.Popen(command, cwd=ROOT, env=environment, stdout=subprocess.DEVNULL, stderr=file)
        started = time.monotonic()
        try:
            while process.poll() is None and "End of training" not in log.read_text():
                assert time.monotonic() - started < LONGEST_RUN_S, log.read_text()[-5000:]
                time.sleep(0.5)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(timeout=LEAVING_S)
            assert process.returncode in (0, None), log.read_text()[-5000:]
        finally:
            process.terminate()
            process.wait()
        return log.read_text()

    return two_processes


@pytest.fixture
def one_process(run_script, capsys):
    """Runs the training script in this process; returns what it logged."""

    def one_process(*arguments):
        run_script(lerobot_train.main, *arguments)
        return capsys.readouterr().err

    return one_process


@pytest.fixture
def arguments(command, long_root, tmp_path):
    """Arguments of a run with a high learning rate whose skills draw no random numbers.

    The latents of the meta controllers, which are drawn in training, have no switch. At 1e-2 they already decide in
    which step the skills are told apart.
    """

    def arguments(name, **settings):
        quiet = {"policy.crop_padding": 0, "policy.subgoal_noise": 0, "policy.boundary_overlap_s": 0}
        quiet |= {"policy.optimizer_lr": 3e-3}
        return command(long_root, **quiet, output_dir=tmp_path / name, **settings)

    return arguments


def test_two_processes_follow_the_losses_of_one(arguments, one_process, two_processes):
    short = {"steps": STEPS, "save_checkpoint": "false"}
    one, other = (losses(one_process(*arguments(f"one{seed}", batch_size=8, seed=seed, **short))) for seed in (1, 2))
    log = two_processes(*arguments("two", batch_size=4, seed=1, **short))
    two = losses(log)
    assert "Effective batch size: 4 x 2 = 8" in log
    assert len(two["loss"]) == STEPS

    # Nothing is drawn: the same but for the order of summation.
    np.testing.assert_allclose(two["skill_loss"], one["skill_loss"], rtol=0, atol=2e-3)
    # Latents are drawn for 4 rows here and 8 there: the same within what another seed changes, and little of what was
    # learned.
    early, late = one["loss"][:LAST].mean(), one["loss"][-LAST:].mean()
    noise = abs(other["loss"][-LAST:].mean() - late)
    assert abs(two["loss"][-LAST:].mean() - late) < min(noise, 0.25 * (early - late))


def test_two_processes_resumed_repeat_the_unbroken_run(arguments, two_processes, tmp_path):
    """A flat policy draws no random numbers.

    LeRobot restores torch's generator, but the loader that it then makes draws its own seed from it. So nothing that is
    drawn after resuming can be the same.
    """
    run = tmp_path / "run"
    flat = {"policy.skills": "flat", "steps": 8, "save_freq": 4}
    unbroken = losses(two_processes(*arguments("run", batch_size=4, **flat)))
    half, last = (read(run, step) for step in (4, 8))
    shutil.rmtree(folder_of(run, 8))
    resumed = losses(
        two_processes(f"--config_path={folder_of(run, 4) / 'pretrained_model/train_config.json'}", "--resume=true")
    )

    assert moved(half, last) == {"model.skills", "optimizer.state"}
    np.testing.assert_array_equal(resumed["skill_loss"], unbroken["skill_loss"][4:])
    assert moved(last, read(run, 8)) == set()


def folder_of(run, step):
    return run / "checkpoints" / f"{step:06}"


def read(run, step):
    """All tensors of a checkpoint: weights, buffers, and the optimizer's."""
    folder = folder_of(run, step)
    optimizer = load_file(folder / "training_state/optimizer_state.safetensors")
    weights = load_file(folder / "pretrained_model/model.safetensors")
    return {**weights, **{f"optimizer.{name}": value for name, value in optimizer.items()}}


def moved(before, after):
    """Parts of a checkpoint that differ."""
    return {
        ".".join(re.split(r"[./]", name)[:2])
        for name in before.keys() | after.keys()
        if name not in before or name not in after or not torch.equal(before[name], after[name])
    }
