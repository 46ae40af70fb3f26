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


def make_report(config: ReportConfig) -> Path:
    """Writes the report.

    Returns:
        Where it is.

    Raises:
        DatasetError: The dataset is damaged or incomplete.
        SegmentationError: It is not segmented, or its labels are out of step with its record.
        StorageError: The file cannot be written.
    """
    from lerobot_buds.report import Content, write_report

    output = Path("outputs/report") / f"{config.repo_id}.html" if config.output is None else Path(config.output)
    write_report(output, Content.read(config.open()), config.repo_id)
    return output


def main() -> None:
    """Entry point of the console script."""
    config = parse(ReportConfig)
    output = run(lambda: make_report(config))
    print(f"{output} ({output.stat().st_size / 1e6:.1f} MB): open it in a browser.")
