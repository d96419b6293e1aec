"""A multirun of `lfref train` as an ablation: one row for each variant, its seeds, and differences from the first row.

A variant is the jobs whose overrides differ in nothing but the seed. Differences are paired: variant less reference,
seed by seed.
The interval of n values with mean m and standard deviation s is m ± t s / √n, where t is the quantile of Student's
distribution with n - 1 degrees of freedom (Student, "The probable error of a mean", Biometrika 6, 1908).
"""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd
from scipy import stats

from lfref.errors import counted
from lfref.io import run as runs
from lfref.io.run import Run
from lfref.report.page import Section

LEVEL = 0.95
"""Probability that an interval covers the mean."""
PLACES = (*runs.FOLDERS, "logger", "callbacks", "seed")
"""First names of keys that change no result, and the seed."""


def section(folder: Path) -> Section:
    """The section of a sweep; the variant of its first job is the reference."""
    jobs = [
        Run(path.parent) for path in sorted(folder.glob(f"*/{runs.CONFIG}"), key=lambda path: (len(str(path)), path))
    ]
    finished = [job for job in jobs if job.is_finished]
    text = f"{len(finished)} of {counted(len(jobs), 'job')} finished."
    if unfinished := ", ".join(job.name for job in jobs if not job.is_finished):
        text += f" Without an end: {unfinished}."
    if not finished:
        return Section(f"Sweep: {folder.name}", text)
    table = summary(single_runs(finished))
    text += (
        " MPSNR is the best of a run's validations, against its own labels: mean and standard deviation over seeds, "
        f"and the difference from {table['variant'].iloc[0]}, seed by seed, with the ends of its 95 % paired t "
        "interval. Of 20 variants without an effect, about one has an interval without 0."
    )
    listed = {"By what varies": table}
    return Section(f"Sweep: {folder.name}", text, tables=listed, files={"sweep.csv": table}, answer=best_setting(table))


def _options(job: Run) -> dict[str, str]:
    """Key of each override that may change the result -> its value."""
    words = {runs.key_of(word): word.partition("=")[2] for word in job.overrides}
    return {key: value for key, value in words.items() if key.partition(".")[0] not in PLACES}


def single_runs(jobs: Sequence[Run]) -> pd.DataFrame:
    """One row for each job: variant, seed, best validation, difference from the first variant, size and time."""
    options = [_options(job) for job in jobs]
    known = dict.fromkeys(key for each in options for key in each)
    keys = [key for key in known if len({each.get(key) for each in options}) > 1]
    rows = []
    for job, each in zip(jobs, options, strict=True):
        varied = [f"{key}={each[key]}" if key in each else f"no {key}" for key in keys]
        log, record = pd.DataFrame(job.metrics).dropna(subset="val/mpsnr"), job.training
        best = log.loc[log["val/mpsnr"].idxmax()]
        rows.append(
            {
                "variant": ", ".join(varied) or "all jobs",
                "seed": job.config.get("seed", 0),
                "best_mpsnr_db": best["val/mpsnr"],
                "mssim": best["val/mssim"],
                "n_parameters": record["n_parameters"],
                "seconds": record["seconds"],
            }
        )
    table = pd.DataFrame(rows)
    is_first = table["variant"] == table["variant"].iloc[0]
    base = table[is_first].groupby("seed")["best_mpsnr_db"].mean()
    table["difference_db"] = (table["best_mpsnr_db"] - table["seed"].map(base)).mask(is_first)
    return table


def t_interval(values: Sequence[float]) -> tuple[float, float]:
    """The interval of the mean of independent values; NaN for fewer than two."""
    series = pd.Series(values, dtype=float)
    low, high = stats.t.interval(LEVEL, len(series) - 1, series.mean(), series.sem())
    return float(low), float(high)


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """One row for each variant: means over its seeds, and its paired difference from the first, with intervals."""
    found = []
    for variant, jobs in rows.groupby("variant", sort=False):
        values = jobs.groupby("seed")[["best_mpsnr_db", "difference_db"]].mean()
        differences = values["difference_db"].dropna()
        low, high = t_interval(differences.tolist())
        found.append(
            {
                "variant": variant,
                "seeds": len(values),
                "mean_db": values["best_mpsnr_db"].mean(),
                "std_db": values["best_mpsnr_db"].std(),
                "difference_db": differences.mean(),
                "difference_low_db": low,
                "difference_high_db": high,
                "mssim": jobs["mssim"].mean(),
                "parameters": jobs["n_parameters"].iloc[0],
                "training_minutes": jobs["seconds"].mean() / 60,
            }
        )
    return pd.DataFrame(found)


def best_setting(table: pd.DataFrame) -> str:
    """The best setting, and how far it is from the reference, in a sentence."""
    place = int(table["mean_db"].to_numpy().argmax())
    best, reference = table.iloc[place].to_dict(), table["variant"].iloc[0]
    words = f"Best of {counted(len(table), 'setting')}: {best['variant']}, with {best['mean_db']:.2f} dB over "
    words += counted(int(best["seeds"]), "seed")
    if place == 0:
        return f"{words}, the reference."
    certain = "" if best["difference_low_db"] > 0 else ", which seeds alone may explain"
    return f"{words}, {best['difference_db']:.2f} dB above the reference ({reference}){certain}."
