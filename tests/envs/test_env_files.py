from pathlib import Path

import draccus
import pytest
from lerobot.envs import EnvConfig

from lerobot_buds.envs import tasks_named
from lerobot_buds.envs.configuration_robosuite import RobosuiteEnvConfig

FILES = sorted((Path(__file__).parents[2] / "configs/env").glob("*.yaml"))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_a_shipped_environment_can_be_included(file: Path) -> None:
    with draccus.config_type("yaml"):
        config = draccus.parse(EnvConfig, args=[f"--config_path={file}"])
    assert isinstance(config, RobosuiteEnvConfig)
    assert file.stem.startswith(tasks_named(config.task)[0].suite)
    assert f"include configs/env/{file.name}" in file.read_text()
