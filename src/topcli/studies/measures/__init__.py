"""Measures: numbers computed from finished runs, for sweeps and their tables."""

from topcli.schemes.registry import plugin_table
from topcli.studies.measures import built_in as built_in
from topcli.studies.measures.batch import Batch, BatchRecorder
from topcli.studies.measures.evaluate import BatchRun, batch_size, evaluate
from topcli.studies.measures.registry import (
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
