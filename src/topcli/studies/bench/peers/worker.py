"""One peer in a process of its own, which answers each request, a line of JSON, with a line of JSON.

    python -m topcli.studies.bench.peers.worker

First ``{"peer", "config", "times": [T, intervals]}`` is answered with its ``variants``. Then ``{"run": [variant,
value]}`` prepares and integrates once and is answered with the states; ``{"time": [variant, value, calls]}`` with the
mean CPU seconds of a warm call over ``calls`` calls. A failure is answered with its reason as ``failed``. Output that
the peer prints goes to stderr.
"""

from __future__ import annotations

import base64
import json
import os
import sys
import time
from collections.abc import Callable, Iterable
from importlib import import_module
from typing import IO, Any

import numpy as np

from topcli.config.load import experiment_from
from topcli.studies.bench.peers import PEERS
from topcli.studies.bench.peers.contract import Call, PeerError, Problem, Variant


class Worker:
    """The variants of one peer for one problem, and the prepared calls."""

    def __init__(self, request: dict[str, Any]) -> None:
        experiment = experiment_from(request["config"])
        span, intervals = request["times"]
        times = np.arange(intervals + 1) * (span / intervals)
        problem = Problem(experiment.top, np.array(experiment.y0), times)
        found = import_module(PEERS[request["peer"]].module).variants(problem)
        self.variants: dict[str, Variant] = {variant.name: variant for variant in found}
        self._calls: dict[tuple[str, float], Call] = {}

    def run(self, name: str, value: float) -> dict[str, Any]:
        """Prepare and call once; return the states and the CPU seconds."""
        started = time.process_time()
        call = self.variants[name].prepare(value)
        compiled = time.process_time()
        states = call()
        ended = time.process_time()
        self._calls[name, value] = call
        text = base64.b64encode(np.ascontiguousarray(states, dtype=np.float64).tobytes()).decode()
        return {"compile_seconds": compiled - started, "seconds": ended - compiled, "states": text}

    def time(self, name: str, value: float, calls: int) -> dict[str, Any]:
        """Call again, warm; return the mean CPU seconds of a call."""
        call = self._calls[name, value]
        started = time.process_time()
        for _ in range(calls):
            call()
        return {"seconds": (time.process_time() - started) / calls}


def _answer(work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    try:
        return work()
    except PeerError as failure:
        return {"failed": str(failure)}
    except Exception as error:  # any exception of a peer is its result
        return {"failed": f"{type(error).__name__}: {error}".splitlines()[0]}


def serve(requests: Iterable[str], answers: IO[str]) -> None:
    """Answer all ``requests``."""
    worker: Worker | None = None

    def start(request: dict[str, Any]) -> dict[str, Any]:
        nonlocal worker
        worker = Worker(request)
        return {
            "variants": [
                {"name": variant.name, "parameter": variant.parameter, "values": list(variant.values)}
                for variant in worker.variants.values()
            ]
        }

    for line in requests:
        request = json.loads(line)
        if worker is None:
            answer = _answer(lambda request=request: start(request))
        else:
            (verb, arguments), *_ = request.items()
            work = {"run": worker.run, "time": worker.time}[verb]
            answer = _answer(lambda work=work, arguments=arguments: work(*arguments))
        print(json.dumps(answer), file=answers, flush=True)


def main() -> None:
    """Answer on the original stdout; all other output goes to stderr."""
    with os.fdopen(os.dup(1), "w", encoding="utf-8") as answers:
        os.dup2(2, 1)
        serve(sys.stdin, answers)
    os._exit(0)  # some peers take long to shut down


if __name__ == "__main__":
    main()
