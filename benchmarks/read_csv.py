"""CSV reading against pandas' C engine: CPU and peak memory, each in its own process, interleaved, in one run.

    python benchmarks/read_csv.py [rows] [repeats]

The file has an epoch column (ms) and 13 channels. "read" holds every column, as pandas does; "batches" streams.
"""

from __future__ import annotations

import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

COLUMNS = 13


def generate(path: Path, rows: int) -> None:
    rng = np.random.default_rng(1)
    with path.open("w", encoding="ascii") as out:
        out.write("time," + ",".join(f"c{i} [kN]" for i in range(COLUMNS)) + "\n")
        for start in range(0, rows, 10_000):
            n = min(10_000, rows - start)
            values = rng.normal(100.0, 10.0, (n, COLUMNS))
            out.writelines(
                f"{1_700_000_000_000 + 100 * (start + i)}," + ",".join(f"{x:.5f}" for x in values[i]) + "\n"
                for i in range(n)
            )


def work(reader: str, path: Path) -> None:
    if reader == "pandas":
        import pandas as pd

        frame = pd.read_csv(path, engine="c")
        total = float(frame.iloc[:, 1:].to_numpy().sum())
    else:
        from mooringdx.config import CsvOptions, TimeSource
        from mooringdx.logs import csv
        from mooringdx.logs.text_layout import layout
        from mooringdx.logs.text_stream import Tally

        if reader == "read":
            log = csv.read(path, None, TimeSource(), CsvOptions())
            total = float(sum(s.values.sum() for s in log.signals.values()))
        else:
            how = layout(path, CsvOptions())
            clock = csv.time_columns(path, how, TimeSource())
            found = csv.batches(path, how, clock, range(1, COLUMNS + 1), Tally())
            total = float(sum(x.sum() for batch in found for x in batch.values))
    used = resource.getrusage(resource.RUSAGE_SELF)
    print(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, total)


def main(rows: int, repeats: int) -> None:
    readers = ("pandas", "read", "batches")
    figures: dict[str, list[tuple[float, float, float]]] = {r: [] for r in readers}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        generate(path, rows)
        size = path.stat().st_size / 1e6
        for _ in range(repeats):
            for reader in readers:
                command = [sys.executable, __file__, "--work", reader, str(path)]
                cpu, peak, total = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
                figures[reader].append((float(cpu), float(peak), float(total)))
    base = statistics.median(f[0] for f in figures["pandas"])
    print(f"{rows} rows x {COLUMNS + 1} columns, {size:.0f} MB, median of {repeats}, whole process")
    for reader in readers:
        cpu, peak = (statistics.median(f[k] for f in figures[reader]) for k in (0, 1))
        print(f"{reader:8} CPU {cpu:6.2f} s  {cpu / base:5.2f} x pandas  peak {peak:6.0f} MB")
    sums = [f[2] for found in figures.values() for f in found]
    if not np.allclose(sums, sums[0], rtol=1e-12):
        raise SystemExit("the readers disagree")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--work"]:
        work(sys.argv[2], Path(sys.argv[3]))
    else:
        main(int(sys.argv[1]) if len(sys.argv) > 1 else 864_000, int(sys.argv[2]) if len(sys.argv) > 2 else 3)
