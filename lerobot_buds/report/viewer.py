"""A recording of a segmentation for the rerun viewer, of the extra ``viz``.

One branch a demonstration, all on the timeline ``time`` from their first frames on (seconds):

    demonstrations/0007/skill             the ribbon: a change of state where a segment begins
    demonstrations/0007/true_stage        the same of its true stages, where these are known
    demonstrations/0007/latents           three principal components of the latents, where these can be computed
    demonstrations/0007/subgoal/agentview the frame with which the present segment ends
"""

from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_buds.core import IMAGE_PREFIX, ConfigError, FloatArray, IntArray, segments_of, write_atomically
from lerobot_buds.segmentation.timeline import label_colors

from .content import Content
from .pictures import Pictures

COMPONENTS = 3
"""Principal components of the latents, taken of all shown demonstrations together."""

QUALITY = 85
"""Of the JPEG of a subgoal, out of 100."""


def write_recording(path: Path, content: Content, name: str) -> None:
    """Writes a recording, atomically.

    Args:
        path: The ``.rrd`` file to create or replace.
        content: What is shown.
        name: Name of the dataset, for the recording.

    Raises:
        ConfigError: rerun is not installed.
        DatasetError: Its frames are damaged.
        StorageError: They do not fit into the frame store, or the file cannot be written.
    """
    rerun = require_rerun()

    with rerun.RecordingStream("lerobot_buds", recording_id=name) as stream:
        # In memory: where its own files cannot be written, rerun logs that and leaves half of them.
        memory = stream.memory_recording()
        stream.send_blueprint(_blueprint(content))
        stream.send_recording_name(name)
        _log(stream, content)
        recorded = memory.drain_as_bytes()
    write_atomically(path, lambda part: part.write_bytes(recorded))


def require_rerun() -> Any:
    """Imports rerun.

    Raises:
        ConfigError: It is not installed.
    """
    try:
        import rerun
    except ImportError as error:
        raise ConfigError(
            "A recording for the rerun viewer needs rerun, which is not installed. Run: pip install "
            "'rerun-sdk>=0.33,<0.34'"
        ) from error
    return rerun


def _log(stream: Any, content: Content) -> None:
    pictures = Pictures(content.dataset, content.side, len(content.numbers))
    names = content.names or tuple(f"skill {skill}" for skill in range(content.record.n_skills))
    components = None if content.latents is None else principal_components(content.latents)
    for place, number in enumerate(content.numbers):
        at, fps = _branch(number), content.dataset.fps
        _log_states(stream, f"{at}/skill", content.labels[place], dict(enumerate(names)), "skills", fps)
        if content.stages is not None:
            stages = content.stages[place]
            _log_states(stream, f"{at}/true_stage", stages, content.stage_names, "stages", fps)
        if components is not None:
            _log_scalars(stream, f"{at}/latents", components[place], fps)
        for camera in pictures.cameras:
            entity = f"{at}/subgoal/{camera.removeprefix(IMAGE_PREFIX)}"
            _log_subgoals(stream, entity, content.labels[place], content.starts[place], pictures, camera, fps)


def principal_components(latents: Sequence[FloatArray]) -> list[FloatArray]:
    """Projects ``(T, D)`` latents of every demonstration to ``(T, min(3, D))``, by the same projection for all."""
    from sklearn.decomposition import PCA

    frames = np.concatenate(latents)
    projected = PCA(min(COMPONENTS, *frames.shape), svd_solver="full").fit_transform(frames)
    return np.split(projected, np.cumsum([len(episode) for episode in latents])[:-1])


def _log_states(stream: Any, entity: str, labels: IntArray, names: Mapping[int, str], kind: str, fps: float) -> None:
    """Logs a ribbon with the colours of our pictures; two labels of one name stay two states."""
    rerun, runs = require_rerun(), segments_of(labels)
    colors = label_colors(list(names), kind)
    stream.log(
        entity,
        rerun.StateConfiguration(
            values=[str(label) for label in names], labels=list(names.values()), colors=list(colors.values())
        ),
        static=True,
    )
    states = [str(run.label) for run in runs] + [""]  # nothing is the state after the end
    times = [run.start / fps for run in runs] + [len(labels) / fps]
    stream.send_columns(entity, _time(times), rerun.StateChange.columns(state=states))


def _log_scalars(stream: Any, entity: str, values: FloatArray, fps: float) -> None:
    rerun = require_rerun()
    names = [f"component {k + 1}" for k in range(values.shape[1])]
    stream.log(entity, rerun.SeriesLines(names=names), static=True)
    stream.send_columns(entity, _time(np.arange(len(values)) / fps), rerun.Scalars.columns(scalars=values))


def _log_subgoals(
    stream: Any, entity: str, labels: IntArray, start: int, pictures: Pictures, camera: str, fps: float
) -> None:
    rerun, runs = require_rerun(), segments_of(labels)
    blobs = [_jpeg(pictures, camera, start + min(run.end, len(labels) - 1)) for run in runs]
    images = rerun.EncodedImage.columns(blob=blobs, media_type=["image/jpeg"] * len(blobs))
    stream.send_columns(entity, _time([run.start / fps for run in runs]), images)


def _jpeg(pictures: Pictures, camera: str, index: int) -> bytes:
    buffer = BytesIO()
    pictures.image(camera, index).save(buffer, "JPEG", quality=QUALITY)
    return buffer.getvalue()


def _time(seconds: Sequence[float] | FloatArray) -> list[Any]:
    return [require_rerun().TimeColumn("time", duration=seconds)]


def _branch(number: int) -> str:
    return f"demonstrations/{number:04d}"


def _blueprint(content: Content) -> Any:
    """Shows the ribbons of all demonstrations, and beside them a tab for each."""
    require_rerun()
    import rerun.blueprint as rrb

    tabs = [
        rrb.Vertical(
            rrb.StateTimelineView(origin=at, name="skills"),
            rrb.TimeSeriesView(origin=f"{at}/latents", name="latents"),
            rrb.Spatial2DView(origin=f"{at}/subgoal", name="goal of the segment"),
            name=f"demonstration {number}",
        )
        for number, at in ((number, _branch(number)) for number in content.numbers)
    ]
    everything = rrb.StateTimelineView(origin="demonstrations", contents="$origin/*/skill", name="all demonstrations")
    return rrb.Blueprint(rrb.Tabs(everything, *tabs), collapse_panels=True)
