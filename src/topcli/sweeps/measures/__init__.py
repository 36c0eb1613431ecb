"""Measures: numbers computed from finished runs, for sweeps and their tables."""

from topcli.schemes.registry import plugin_table
from topcli.sweeps.measures import built_in as built_in
from topcli.sweeps.measures.batch import Batch, BatchRecorder
from topcli.sweeps.measures.evaluate import BatchRun, Limit, batch_size, evaluate
from topcli.sweeps.measures.registry import (
    MEASURES,
    Measure,
    MeasureMisfitError,
    NoCounterError,
    all_measures,
    measure,
    measures_of_form,
    names_of,
    resolve_measures,
)

__all__ = [
    "MEASURES",
    "Batch",
    "BatchRecorder",
    "BatchRun",
    "Limit",
    "Measure",
    "MeasureMisfitError",
    "NoCounterError",
    "all_measures",
    "batch_size",
    "evaluate",
    "measure",
    "measures_of_form",
    "names_of",
    "resolve_measures",
]

plugin_table(MEASURES)
