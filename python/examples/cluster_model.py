"""How long a cluster would take for a drive of any length: a measured report of tsdfuse.ray, scheduled on more nodes.

    python cluster_model.py report.json --km 5 --target-km 1000 --nodes 64

Tasks take the processor's time that they took in the report. Each also reads and writes files through the shared storage, at the rate of
its node's network and its share of what the storage can deliver in all. Tasks of a phase start as soon as a processor is free, the longest
first; a phase begins when the one before has ended.
"""

import argparse
import heapq
import json
from pathlib import Path


def phase(seconds: list[float], byte_count: list[float], cpus: int, node_rate: float, storage_rate: float) -> tuple[float, float]:
    """Seconds until all tasks are done, and of that what transfers alone would take."""
    at_once = min(cpus, len(seconds))
    # A node's processors share its network, all nodes the storage.
    rate = min(node_rate, storage_rate / at_once)
    ends = [0.0] * at_once
    heapq.heapify(ends)
    for took in sorted((s + b / rate for s, b in zip(seconds, byte_count)), reverse=True):
        heapq.heappush(ends, heapq.heappop(ends) + took)
    return max(ends), sum(byte_count) / min(storage_rate, node_rate * at_once)


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    asked.add_argument("report")
    asked.add_argument("--km", type=float, required=True, help="what the report is of")
    asked.add_argument("--target-km", type=float, default=1000)
    asked.add_argument("--nodes", type=int, default=64)
    asked.add_argument("--cpus", type=int, default=16, help="of each node")
    asked.add_argument("--network", type=float, default=10, help="Gbit/s of each node")
    asked.add_argument("--storage", type=float, default=40, help="Gbit/s of the shared storage in all")
    asked.add_argument("--scan-bytes", type=float, default=0.5e6, help="of a scan in the log")
    a = asked.parse_args()
    report = json.loads(Path(a.report).read_text())
    records = Path(report["job"]["work"]) / "records"
    copies = round(a.target_km / a.km)
    total, moved = 0.0, 0.0
    print(f"{report['scans'] * copies} scans, {report['cells'] * copies} cells on {a.nodes} nodes of {a.cpus} processors")
    for told in report["phases"]:
        if told["phase"] == "look":
            continue
        seconds, byte_count = [], []
        for path in sorted((records / told["phase"]).glob("*.json")):
            record = json.loads(path.read_text())
            seconds.append(sum(record["cpu_seconds"].values()))
            parts = record.get("parts") or [record[key] for key in ("part",) if record.get(key)]
            written = sum(part["map"]["bytes"] + part["skin"]["bytes"] for part in parts)
            written += (record.get("tiles") or {}).get("bytes", 0)
            byte_count.append(written + record.get("read", 0) + record.get("fused", 0) * a.scan_bytes)
        if not seconds:
            continue
        cpus = a.nodes * a.cpus
        wall, transfer = phase(seconds * copies, byte_count * copies, cpus, a.network / 8e-9 / a.cpus, a.storage / 8e-9)
        compute = sum(seconds) * copies / cpus
        total, moved = total + wall, moved + sum(byte_count) * copies
        print(
            f"{told['phase']:>8}: {len(seconds) * copies:7} tasks, {wall / 60:7.1f} min; the processors alone {compute / 60:6.1f} min,"
            f" transfers alone {transfer / 60:6.1f} min, {sum(byte_count) * copies / 1e12:.2f} TB"
        )
    print(f"in all {total / 3600:.2f} h, {moved / 1e12:.2f} TB moved")


if __name__ == "__main__":
    main()
