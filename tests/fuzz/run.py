#!/usr/bin/env python3
"""Builds all fuzz targets, runs them one after the other and prints a table.

    python3 tests/fuzz/run.py                                # 60 seconds each
    python3 tests/fuzz/run.py --count 10000000 --seconds 3600
    python3 tests/fuzz/run.py --only calibration,onnx

Each target runs until it has done `--count` executions or `--seconds` are over, whichever comes first. What it has
learnt stays in `target/corpus`, what crashed it in `target/crashes`; after a crash it goes on, at most
MOST_CRASHES times. The options of the compiler are those that cargo-fuzz passes without a sanitizer; all of them
are stable, so neither cargo-fuzz nor a nightly compiler is needed.
"""

import argparse
import os
import re
import subprocess
import sys
import time
import tomllib
from pathlib import Path

HERE = Path(__file__).resolve().parent
OUT = HERE / "target"
MOST_CRASHES = 3

# Coverage of edges with 8-bit counters, and what is compared with what.
FLAGS = [
    "--cfg=fuzzing",
    "-Cpasses=sancov-module",
    "-Cllvm-args=-sanitizer-coverage-level=4",
    "-Cllvm-args=-sanitizer-coverage-inline-8bit-counters",
    "-Cllvm-args=-sanitizer-coverage-pc-table",
    "-Cllvm-args=-sanitizer-coverage-trace-compares",
    "-Cllvm-args=-simplifycfg-branch-fold-threshold=0",
]

# Most megabytes of a target, and seconds of one execution. The embedded runtime may hold tensors of 4 GiB.
MEMORY_MB = {"embedded": 10_000}
TIMEOUT_S = 60


def build():
    """The folder of the programs."""
    triple = re.search(r"^host: (.*)$", subprocess.check_output(["rustc", "-vV"], text=True), re.M)[1]
    # With a named target the options reach neither build scripts nor macros.
    environment = os.environ | {"CARGO_ENCODED_RUSTFLAGS": "\x1f".join(FLAGS), "CARGO_TARGET_DIR": str(OUT)}
    command = ["cargo", "build", "--release", "--locked", "--target", triple, "--manifest-path", HERE / "Cargo.toml"]
    subprocess.run(command, env=environment, check=True)
    return OUT / triple / "release"


def run_once(program, count, seconds, seed):
    """Executions, and whether it ended with a crash, a hang or out of memory."""
    corpus, crashes = OUT / "corpus" / program.name, OUT / "crashes" / program.name
    corpus.mkdir(parents=True, exist_ok=True)
    crashes.mkdir(parents=True, exist_ok=True)
    command = [
        program,
        corpus,
        f"-runs={count}",
        f"-max_total_time={seconds}",
        f"-timeout={TIMEOUT_S}",
        f"-rss_limit_mb={MEMORY_MB.get(program.name, 2048)}",
        f"-artifact_prefix={crashes}/",
        "-max_len=4096",
        "-print_final_stats=1",
        f"-seed={seed}",
    ]
    log = OUT / f"{program.name}.log"
    with log.open("ab") as file:
        ended = subprocess.run(command, stdout=file, stderr=file, check=False)
    found = re.findall(r"number_of_executed_units: (\d+)", log.read_text(errors="replace"))
    return int(found[-1]) if found else 0, ended.returncode != 0


def main():
    parser = argparse.ArgumentParser(description="Runs all fuzz targets and prints a table.")
    parser.add_argument("--count", type=int, default=10_000_000, help="executions of each target [10000000]")
    parser.add_argument("--seconds", type=int, default=60, help="seconds of each target [60]")
    parser.add_argument("--only", default="", help="names of targets, separated by commas")
    parser.add_argument("--seed", type=int, default=1, help="seed of the first run of each target [1]")
    arguments = parser.parse_args()
    manifest = tomllib.loads((HERE / "Cargo.toml").read_text())
    names = [target["name"] for target in manifest["bin"]]
    chosen = [name for name in arguments.only.split(",") if name] or names
    unknown = sorted(set(chosen) - set(names))
    if unknown:
        sys.exit(f"there is no target {', '.join(unknown)}; there are {', '.join(names)}")
    folder = build()
    print("| target | executions | seconds | crashes |\n|---|---:|---:|---:|", flush=True)
    failed = False
    for name in chosen:
        (OUT / f"{name}.log").unlink(missing_ok=True)
        began, done, crashes = time.monotonic(), 0, 0
        while True:
            left = arguments.seconds - int(time.monotonic() - began)
            if done >= arguments.count or left <= 0 or crashes >= MOST_CRASHES:
                break
            # What crashed would crash again under the same seed.
            executions, crashed = run_once(folder / name, arguments.count - done, left, arguments.seed + crashes)
            done += executions
            if not crashed:
                break
            crashes += 1
        failed |= crashes > 0
        print(f"| {name} | {done:,} | {time.monotonic() - began:.0f} | {crashes} |", flush=True)
    if failed:
        sys.exit(f"inputs that crashed a target lie in {OUT / 'crashes'}; what it said is in {OUT}/*.log")


if __name__ == "__main__":
    main()
