"""``lerobot-buds-report``: makes one HTML file of a segmented dataset, to be looked at."""

from dataclasses import dataclass
from pathlib import Path

from .datasets import DatasetOptions
from .running import parse, run


@dataclass
class ReportConfig(DatasetOptions):
    """Settings of a report; the dataset must be segmented."""

    output: Path | None = None
    """The file; None for ``outputs/report/`` and the dataset's name with ``.html`` behind it."""

    comparison: Path | None = None
    """The ``comparison.json`` that ``lerobot-buds-compare`` wrote of the same demonstrations: other methods' scores."""

    rerun: Path | None = None
    """Writes a recording for the rerun viewer there as well, ``.rrd``; needs the extra ``viz``."""


def make_report(config: ReportConfig) -> Path:
    """Writes the report.

    Returns:
        Where it is.

    Raises:
        ConfigError: A recording is asked for and rerun is not installed.
        DatasetError: The dataset is damaged or incomplete, or the file of the comparison holds none, or one of other
            demonstrations.
        SegmentationError: It is not segmented, or its labels are out of step with its record.
        StorageError: The file cannot be written.
    """
    from lerobot_buds.data import Origin
    from lerobot_buds.report import Content, require_rerun, rivals, write_recording, write_report

    if config.rerun is not None:
        require_rerun()
    dataset = config.open()
    compared = None if config.comparison is None else rivals(config.comparison, Origin.of(dataset))
    output = Path("outputs/report") / f"{config.repo_id}.html" if config.output is None else Path(config.output)
    content = Content.read(dataset)
    write_report(output, content, config.repo_id, compared)
    if config.rerun is not None:
        write_recording(config.rerun, content, config.repo_id)
    return output


def main() -> None:
    """Entry point of the console script."""
    config = parse(ReportConfig)
    output = run(lambda: make_report(config))
    print(f"{output} ({output.stat().st_size / 1e6:.1f} MB): open it in a browser.")
    if config.rerun is not None:
        print(f"{config.rerun} ({config.rerun.stat().st_size / 1e6:.1f} MB): open it with rerun.")
