"""The processes of benchmarks, and their cost: the machine's figures as the thesis measures them,
and exact figures per process."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from typing import Dict, Iterable, List, NamedTuple, Optional

import psutil

SAMPLES = 5
"""Measurements that are averaged for each figure (thesis 6.1)."""


class MachineLoad(NamedTuple):
    """The two figures of the thesis: use of all processors (%), use of memory (%)."""

    cpu_percent: float
    memory_percent: float


class ProcessCost(NamedTuple):
    """Sums over processes. ``cpu_seconds``: since each started; ``pss_mb``: their proportional
    share of memory, in MB of 10^6 bytes."""

    processes: int
    cpu_seconds: float
    pss_mb: float
    threads: int
    descriptors: int


def peak_mb(usage: Optional[resource.struct_rusage] = None) -> float:
    """The most memory that a process had, in MB of 10^6 bytes.

    :param usage: of which process; of this one if not given.
    """
    used = usage or resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_maxrss * 1024 / 1e6


class Verb(NamedTuple):
    """What a verb of ``gspn`` printed and took. ``code``: its exit code; ``output``: of its
    standard output; ``cpu_seconds``, ``wall_seconds``: with its start; ``peak_mb``: see
    :func:`peak_mb`."""

    code: int
    output: str
    cpu_seconds: float
    wall_seconds: float
    peak_mb: float


def run_verb(*words: str) -> Verb:
    """Run ``gspn WORDS`` as a separate process, to its end."""
    begin = time.monotonic()
    with tempfile.TemporaryFile("w+", encoding="utf-8") as out:
        command = [sys.executable, "-m", "gspn_framework_package", *words]
        process = subprocess.Popen(command, stdout=out)
        _, status, usage = os.wait4(process.pid, 0)
        wall = time.monotonic() - begin
        process.returncode = -os.WTERMSIG(status) if os.WIFSIGNALED(status) else status >> 8
        out.seek(0)
        cpu = usage.ru_utime + usage.ru_stime
        return Verb(process.returncode, out.read(), cpu, wall, peak_mb(usage))


def machine_load(period: float) -> MachineLoad:
    """Five measurements over ``period`` seconds in all, averaged, by ``psutil.cpu_percent`` and
    ``virtual_memory`` as in the thesis."""
    cpu: List[float] = []
    memory: List[float] = []
    for _ in range(SAMPLES):
        cpu.append(psutil.cpu_percent(interval=period / SAMPLES))
        memory.append(psutil.virtual_memory().percent)
    return MachineLoad(sum(cpu) / SAMPLES, sum(memory) / SAMPLES)


def descendants(pid: int) -> List[psutil.Process]:
    """All child processes of ``pid``, and their children, recursively."""
    try:
        return psutil.Process(pid).children(recursive=True)
    except psutil.NoSuchProcess:
        return []


def cpu_seconds(processes: Iterable[psutil.Process]) -> Dict[int, float]:
    """User plus system time (s) of each process so far, by process id."""
    seconds = {}
    for process in processes:
        try:
            times = process.cpu_times()
        except psutil.NoSuchProcess:
            continue
        seconds[process.pid] = times.user + times.system
    return seconds


def cost_of(processes: Iterable[psutil.Process]) -> ProcessCost:
    """The cost of the processes so far. Reading the shared memory takes a few milliseconds for
    each."""
    count, cpu, pss, threads, descriptors = 0, 0.0, 0, 0, 0
    for process in processes:
        try:
            with process.oneshot():
                times = process.cpu_times()
                pss += process.memory_full_info().pss
                threads += process.num_threads()
                descriptors += process.num_fds()
        except (psutil.NoSuchProcess, psutil.ZombieProcess):
            continue
        count += 1
        cpu += times.user + times.system
    return ProcessCost(count, cpu, pss / 1e6, threads, descriptors)


def end_cleanly_on_signal() -> None:
    """Make SIGTERM what Ctrl-C is, so that the processes of a benchmark end with it."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)


def quiet_machine(period: float = 5.0) -> MachineLoad:
    """The baseline: the load before anything is started."""
    time.sleep(0.5)
    return machine_load(period)
