"""The log of a run as a CSV file, which a resumed run goes on with."""

import csv
from pathlib import Path

from lightning.fabric.loggers.csv_logs import _ExperimentWriter
from lightning.pytorch import loggers
from lightning.pytorch.loggers.csv_logs import ExperimentWriter
from lightning.pytorch.loggers.logger import rank_zero_experiment


class _Continued(ExperimentWriter):
    """Lightning's writer deletes the log that it finds; this one goes on below it."""

    def _check_log_dir_exists(self) -> None:
        path = Path(self.metrics_file_path)
        if path.is_file():
            with path.open(newline="", encoding="utf-8") as file:
                self.metrics_keys = next(csv.reader(file), [])


class CSVLogger(loggers.CSVLogger):
    """Lightning's logger of that name, but for what is in the file already: that stays."""

    @property
    @rank_zero_experiment
    def experiment(self) -> _ExperimentWriter:
        """The writer of the file, made when it is first needed."""
        if self._experiment is None:
            self._experiment = _Continued(log_dir=self.log_dir)
        return self._experiment
