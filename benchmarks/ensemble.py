"""Time of ensembles per trajectory-step and core, gain by a second thread, and cost of large ensembles.

    python benchmarks/ensemble.py [--repetitions 21] [--members 10000 100000 1000000]

The baselines are one step of straightforward HK, as in `benchmarks/steps.py`, and one step of the same scheme, both of
a single trajectory. Two threads need two idle cores: the ratio of the least times is beside that of the medians. Each
large ensemble is a process of its own with one thread: memory must not grow with the members, nor the time of each.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time

import numpy as np
from steps import GENERIC, H, ratio, stepping, straightforward

from topcli.engine.drive import drive
from topcli.engine.machine import Machine
from topcli.engine.rows import Plan
from topcli.schemes.registry import find_scheme
from topcli.tops import TOPS

STEPS, COUNT = 20_000, 1024
CASES = (
    "hk/kowalevski",
    "hk+suzuki4/kowalevski",
    "hybrid/kowalevski",
    "rk4/kowalevski",
    "midpoint/kowalevski",
    "splitting/kowalevski",
    "hk/euler",
    "bs/euler",
    "bs/lagrange/inertial",
    "hk/lagrange",
    "hk/heavy",
    "dmv/heavy",
)
LARGE = """
import resource, sys, tempfile, time
import topcli
members, store = int(sys.argv[1]), sys.argv[2]
sets = [f"ensemble.random.count={members}", f"ensemble.store={store}", "N=1000", "output.every=1000"]
begin = time.process_time()
with tempfile.TemporaryDirectory() as out:
    topcli.run("kowalevski_ensemble", out, overrides=sets, threads=1, progress=False)
spent = time.process_time() - begin
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(f"{spent / members * 1e6:.2f} us each, {peak:.0f} MB at most")
"""


def show(name: str, repetitions: int) -> None:
    """Time one scheme and print its row."""
    scheme_name, _, form = name.partition("/")
    scheme, top = find_scheme(scheme_name, form), TOPS[form].new()
    method = scheme.build(top, scheme.options())
    machine = Machine(top, method)
    d = len(top.components)
    y0 = np.resize(GENERIC, d) + np.random.default_rng(3).normal(scale=0.1, size=(COUNT, d))

    def together(threads: int) -> tuple[float, float]:
        """Nanoseconds per trajectory-step, of the processor and of the clock."""
        plan = Plan(top, machine, y0, H, STEPS, STEPS)
        begin, cpu = time.perf_counter_ns(), time.process_time_ns()
        drive(plan, threads=threads)
        spent = time.process_time_ns() - cpu, time.perf_counter_ns() - begin
        return spent[0] / STEPS / COUNT, spent[1] / STEPS / COUNT

    baseline, alone = straightforward(), stepping(top, method)
    rows = [(baseline(), alone(), *together(1), together(2)[1]) for _ in range(repetitions + 1)][1:]
    base, single, cpu, one, two = zip(*rows, strict=True)
    columns = (ratio(cpu, base), ratio(cpu, single), f"{ratio(one, two)}, least {min(one) / min(two):.2f}")
    print(f"{name:<24}{np.median(cpu):>7.2f}   " + "   ".join(columns), flush=True)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repetitions", type=int, default=21)
    parser.add_argument("--members", type=int, nargs="*", default=[10_000, 100_000, 1_000_000])
    arguments = parser.parse_args()
    print(f"{'':<24}{'ns':>7}   {'to straightforward HK':<22}   {'to a single run':<22}   gain by a second thread")
    for name in CASES:
        show(name, arguments.repetitions)
    for store in ("statistics", "final"):
        for members in arguments.members:
            command = [sys.executable, "-c", LARGE, str(members), store]
            done = subprocess.run(command, check=True, capture_output=True, text=True)
            print(f"{members} members, {store}: {done.stdout.strip()}", flush=True)


if __name__ == "__main__":
    main()
