"""A multirun of `lfref train` as an ablation: one row for each variant, its seeds, and differences from the first row.

A variant is the jobs that differ in nothing but the seed. Differences are paired: variant less reference, seed by seed.
The interval of n values with mean m and standard deviation s is m ± t s / √n, where t is the quantile of Student's
distribution with n - 1 degrees of freedom (Student, "The probable error of a mean", Biometrika 6, 1908).
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from scipy import stats

from lfref.errors import counted
from lfref.io import run as runs
from lfref.io.run import Run
from lfref.report import plots, tables
from lfref.report.page import Section

LEVEL = 0.95
"""Probability that an interval covers the mean."""
PLACES = (*runs.FOLDERS, "logger", "callbacks", "seed")
"""First names of keys that change no result, and the seed."""


def is_sweep(folder: Path) -> bool:
    """Whether a folder holds jobs of a sweep of trainings."""
    return any(folder.glob(f"*/{runs.METRICS}"))


def section(folder: Path) -> Section:
    """The section of a sweep; the variant of its first job is the reference."""
    jobs = [Run(path.parent) for path in sorted(folder.glob(f"*/{runs.CONFIG}"), key=_number)]
    finished = [job for job in jobs if job.is_finished]
    unfinished = ", ".join(job.name for job in jobs if not job.is_finished)
    title, n_jobs = f"Sweep: {folder.name}", counted(len(jobs), "job")
    if not finished:
        return Section(title, f"None of {n_jobs} has finished.")
    rows, keys = single_runs(finished)
    table = summary(rows, keys)
    names = [", ".join(row[keys].astype(str)) or "all jobs" for _, row in table.iterrows()]
    curves = pd.concat(
        validations(job).assign(variant=names[variant], seed=seed)
        for job, variant, seed in zip(finished, rows["variant"], rows["seed"], strict=True)
    )
    text = f"{len(finished)} of {n_jobs} finished." + (f" Without an end: {unfinished}." if unfinished else "")
    text += (
        " MPSNR is the best of a run's validations, against its own labels; ± is the standard deviation over seeds. "
        f"Reference: {names[0]}. In brackets: the 95 % paired t interval of the mean difference, bold if it excludes "
        "0. Of 20 variants without an effect, about one is bold."
    )
    caption = "Validation MPSNR by step: mean over the seeds, and band from the lowest to the highest; grey: reference"
    return Section(
        title,
        text,
        {caption: plots.sweep_curves(curves, names[0])},
        {"By what varies": for_page(table, keys)},
        files={"sweep.csv": table, "sweep_jobs.csv": rows},
        answer=best_setting(table, names),
    )


def _number(config: Path) -> tuple[int, str]:
    name = config.parent.name
    return (int(name) if name.isdecimal() else -1), name


def flat(config: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Key such as `net.width` -> its value; a list is one value."""
    entries: dict[str, Any] = {}
    for name, value in config.items():
        entries |= flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": value}
    return entries


def validations(job: Run) -> pd.DataFrame:
    """Columns `step` and `val/mpsnr` of a job's log, and `val/mssim` if it has one."""
    log = tables.require_numbers(pd.DataFrame(job.metrics), "val/mpsnr")
    return log[[name for name in ("step", "val/mpsnr", "val/mssim") if name in log]]


def single_runs(jobs: Sequence[Run]) -> tuple[pd.DataFrame, list[str]]:
    """One row for each job: its variant's number, seed, what varies, best validation, difference from variant 0; and
    the keys that vary."""
    configs = [flat(job.config) for job in jobs]
    known = dict.fromkeys(key for config in configs for key in config if key.partition(".")[0] not in PLACES)
    texts = [{key: str(config.get(key, tables.DASH)) for key in known} for config in configs]
    keys = [key for key in known if len({text[key] for text in texts}) > 1]
    # A configuration holds an option at each place that refers to it: the shortest key names it.
    by_length = sorted(keys, key=lambda key: (key.count("."), keys.index(key)), reverse=True)
    groups = {tuple(_pattern([text[key] for text in texts])): key for key in by_length}
    keys = [key for key in keys if key in groups.values()]
    variants = _pattern([tuple(text[key] for key in keys) for text in texts])
    rows = []
    for job, config, text, variant in zip(jobs, configs, texts, variants, strict=True):
        log = validations(job)
        best = log.loc[log["val/mpsnr"].idxmax()]
        values = {"best_mpsnr_db": best["val/mpsnr"], "mssim": best.get("val/mssim", math.nan)}
        costs = {f"{name}": job.training[name] for name in ("n_parameters", "seconds", "device")}
        place = {"job": job.name, "variant": variant, "seed": config.get("seed", 0)}
        rows.append({**place, **{key: text[key] for key in keys}, **values, **costs})
    table = pd.DataFrame(rows).rename(columns={"seconds": "training_s"})
    base = table[table["variant"] == 0].groupby("seed")["best_mpsnr_db"].mean()
    table["difference_db"] = (table["best_mpsnr_db"] - table["seed"].map(base)).where(table["variant"] > 0)
    return table, keys


def _pattern(values: Sequence[Any]) -> list[int]:
    """The number of each value among the different ones, in the order of their first places."""
    numbers = {value: number for number, value in enumerate(dict.fromkeys(values))}
    return [numbers[value] for value in values]


def t_interval(values: Sequence[float]) -> tuple[float, float]:
    """The interval of the mean of independent values; NaN for fewer than two."""
    n = len(values)
    if n < 2:
        return math.nan, math.nan
    series = pd.Series(values, dtype=float)
    half = float(stats.t.ppf((1 + LEVEL) / 2, n - 1)) * series.std() / math.sqrt(n)
    return series.mean() - half, series.mean() + half


def summary(rows: pd.DataFrame, keys: Sequence[str]) -> pd.DataFrame:
    """One row for each variant: means over its seeds, and its paired difference from the first, with intervals."""
    found = []
    for _, jobs in rows.groupby("variant"):
        values = jobs.groupby("seed")[["best_mpsnr_db", "difference_db"]].mean()
        differences = values["difference_db"].dropna()
        low, high = t_interval(differences.tolist())
        found.append(
            {
                **jobs.iloc[0][list(keys)],
                "n_seeds": len(values),
                "mean_db": values["best_mpsnr_db"].mean(),
                "std_db": values["best_mpsnr_db"].std(),
                "difference_db": differences.mean(),
                "difference_low_db": low,
                "difference_high_db": high,
                "mssim": jobs["mssim"].mean(),
                "n_parameters": jobs["n_parameters"].iloc[0],
                "training_s": jobs["training_s"].mean(),
            }
        )
    return pd.DataFrame(found)


def for_page(table: pd.DataFrame, keys: Sequence[str]) -> pd.DataFrame:
    """The summary with means, deviations and intervals as text; bold where an interval excludes 0."""
    rows = table.to_dict("records")
    shown = table[[*keys, "n_seeds"]].assign(mean_and_std=[_mean_and_std(row) for row in rows])
    if len(table) > 1:
        shown["difference"] = ["reference", *map(_difference, rows[1:])]
    return shown.assign(**table[["mssim", "n_parameters", "training_s"]])


def best_setting(table: pd.DataFrame, names: Sequence[str]) -> str:
    """The best setting, and how far it is from the reference, in a sentence."""
    place = int(table["mean_db"].to_numpy().argmax())
    best = table.iloc[place].to_dict()
    words = f"Best of {counted(len(table), 'setting')}: {names[place]}, with {_mean_and_std(best)} dB"
    words += f" over {counted(int(best['n_seeds']), 'seed')}"
    if place == 0:
        return f"{words}, the reference." if len(table) > 1 else f"{words}."
    low, difference = best["difference_low_db"], f"{best['difference_db']:.2f} dB above the reference ({names[0]})"
    reading = " by a single seed, which proves nothing" if math.isnan(low) else ", which seeds alone may explain"
    return f"{words}, {difference}{'' if low > 0 else reading}."


def _mean_and_std(row: Mapping[str, Any]) -> str:
    return f"{row['mean_db']:.2f}" + ("" if math.isnan(row["std_db"]) else f" ± {row['std_db']:.2f}")


def _difference(row: Mapping[str, Any]) -> str:
    mean, low, high = (row[f"difference_{name}db"] for name in ("", "low_", "high_"))
    if math.isnan(mean):
        return tables.DASH
    if math.isnan(low):
        return f"{mean:+.2f}".replace("-", tables.MINUS)
    text = f"{mean:+.2f} ({low:+.2f} to {high:+.2f})".replace("-", tables.MINUS)
    return tables.Bold(text) if low > 0 or high < 0 else text
