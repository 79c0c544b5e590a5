"""The command ``tsdfuse-ray``."""

from __future__ import annotations

import argparse
import json
import logging
import sys
from typing import Any

import tsdfuse

from ._fuse import fuse


def parser() -> argparse.ArgumentParser:
    made = argparse.ArgumentParser(prog="tsdfuse-ray", description="Fuse logs on the nodes of a Ray cluster.")
    made.add_argument("--version", action="version", version=f"tsdfuse {tsdfuse.__version__}")
    commands = made.add_subparsers(dest="command", required=True)
    add = commands.add_parser(
        "fuse", help="fuse logs into 3D Tiles", description="Fuse logs into 3D Tiles. A run that was ended early goes on with the same command."
    ).add_argument
    add("logs", nargs="+", metavar="LOG", help="logs in one world, as all nodes see them, or URLs (s3://...)")
    add("-o", "--output", required=True, metavar="NAME/tileset.json", help="the tileset to write, in a folder of its own or a URL")
    add("--work", metavar="DIR", help="folder or URL for maps and records [default: NAME.work]")
    add("--address", help="the cluster [default: RAY_ADDRESS, or this machine alone]")
    add("--span", type=int, default=200, metavar="SCANS", help="scans of one task [default: 200]")
    add("--memory-per-task", default="2G", metavar="SIZE", help="most memory for the map of one task [default: 2G]")
    add("--cpus-per-task", type=float, default=1, metavar="N", help="threads of one task [default: 1]")
    add("--cell", type=int, metavar="REGIONS", help="regions of 64 voxels along the edge of a cell [default: 16; 64 for methods that erase]")
    add("--retries", type=int, default=3, metavar="N", help="tries of a task whose worker or node was lost [default: 3]")
    add("--method", help="the fusion method")
    add("--voxel-size", type=float, metavar="M")
    add("--truncation", type=float, metavar="M")
    add("--min-range", type=float, metavar="M")
    add("--max-range", type=float, metavar="M")
    add("--min-weight", type=float, metavar="W")
    add("--scans", metavar="FROM..TO[:STEP]", help="fuse only these scans of each log")
    add("--poses", metavar="FILE|NAME", help="a pose file, a topic or a frame [default: the log's]")
    add("--sensor", action="append", metavar="NAME", help="a sensor of the log, or the model of the only one; may be repeated")
    add("--calibration", metavar="FILE")
    add("--config", metavar="FILE", help="read settings from a TOML file")
    add("--set", action="append", default=[], metavar="KEY=VALUE", help="set one key of the configuration")
    add("--skip-bad", action="store_true", help="skip scans that cannot be used; the exit code is then 3")
    add("--report", metavar="FILE", help="write a JSON report")
    add("--json", action="store_true", help="print the report")
    return made


def settings(asked: argparse.Namespace) -> tsdfuse.Config:
    """A file, and single keys over it."""
    config: dict[str, Any] = {}
    for setting in asked.set:
        key, found, value = setting.partition("=")
        if not found:
            raise tsdfuse.ConfigError(f"--set {setting}: key=value is wanted, as in map.voxel_size_m=0.1")
        try:
            config[key.strip()] = json.loads(value)
        except ValueError:
            config[key.strip()] = value.strip().strip("\"'")
    over = tsdfuse.Config(config)
    if asked.config is None:
        return over
    from ._fuse import _flat

    return tsdfuse.Config({**_flat(tsdfuse.Config(asked.config).settings()), **_flat(over.settings())})


def main(arguments: list[str] | None = None) -> int:
    asked = parser().parse_args(arguments)
    try:
        import ray

        ray.init(address=asked.address, log_to_driver=False, logging_level=logging.WARNING)
        report = fuse(
            asked.logs, asked.output, work=asked.work, span=asked.span, memory_per_task=asked.memory_per_task,
            cpus_per_task=asked.cpus_per_task, cell=asked.cell, retries=asked.retries, method=asked.method,
            voxel_size=asked.voxel_size, truncation=asked.truncation, min_range=asked.min_range, max_range=asked.max_range,
            min_weight=asked.min_weight, scans=asked.scans, poses=asked.poses, sensor=asked.sensor,
            calibration=asked.calibration, config=settings(asked), skip_bad=asked.skip_bad, report=asked.report,
            progress=True if sys.stderr.isatty() else None,
        )  # fmt: skip
    except ImportError:
        sys.stderr.write("tsdfuse-ray: error: Ray is not installed: pip install 'tsdfuse[ray]'\n")
        return 1
    except (tsdfuse.Error, OSError, ValueError) as error:
        sys.stderr.write(f"tsdfuse-ray: error: {error}\n")
        return 2 if isinstance(error, tsdfuse.ConfigError) else 1
    for skipped in report["skipped_scans"]:
        sys.stderr.write(f"tsdfuse-ray: note: skipped {skipped}\n")
    if report["limited_voxels"]:
        sys.stderr.write(f"tsdfuse-ray: note: {report['limited_voxels']} voxels reached max_weight: not the bits of one machine\n")
    sys.stderr.write(
        f"  scans    {report['scans']} in {report['spans']} spans\n  cells    {report['cells']}, {report['blocks']} blocks\n"
        f"  seconds  {report['wall_seconds']:.1f}\n  wrote    {asked.output}\n"
    )
    if asked.json:
        sys.stdout.write(json.dumps(report, indent=1) + "\n")
    return 3 if report["skipped_scans"] else 0


if __name__ == "__main__":
    sys.exit(main())
