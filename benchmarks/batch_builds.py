"""A batch of short logs, some broken: killed and restarted, on a cluster, in an object store.

    python benchmarks/batch_builds.py [CASE...] [--logs 40] [--broken 3] [--keep FOLDER]

Cases: killed, cluster, store; all when none is named. Each is compared with an unbroken run on
this machine, byte by byte. `store` needs s3fs and moto[server], which no other part of the
project does.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from robust.batches import Ran, differences, kill_batch, products, run_batch, write_logs

Case = Callable[[Path, int], tuple[Ran, dict[str, bytes]]]


def killed(manifest: Path, count: int) -> tuple[Ran, dict[str, bytes]]:
    """A build is killed after a quarter of the logs, the batch after half; then it goes on."""
    output = manifest.parent / "killed"
    orphans = kill_batch(manifest, output, count // 4, count // 2)
    print(f"killed: builds left running by the dead batch: {orphans}")
    ran = run_batch(manifest, output)
    print(f"killed: {ran.stderr.splitlines()[0]}")
    return ran, products(output)


def cluster(manifest: Path, _count: int) -> tuple[Ran, dict[str, bytes]]:
    """Dask with two workers on this machine, in processes of their own."""
    from distributed import LocalCluster

    output = manifest.parent / "cluster"
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    with LocalCluster(processes=True, **options) as dask:
        return run_batch(manifest, output, "--scheduler", dask.scheduler_address), products(output)


def store(manifest: Path, _count: int) -> tuple[Ran, dict[str, bytes]]:
    """Logs read from a bucket of an S3 server on this machine, maps written into another."""
    import s3fs
    from moto.server import ThreadedMotoServer

    server = ThreadedMotoServer(port=0)
    server.start()
    host, port = server.get_host_and_port()
    os.environ |= {
        "AWS_ENDPOINT_URL": f"http://{host}:{port}",
        "AWS_ACCESS_KEY_ID": "any",
        "AWS_SECRET_ACCESS_KEY": "any",
        "AWS_DEFAULT_REGION": "us-east-1",
    }
    bucket = s3fs.S3FileSystem()
    for name in ("logs", "maps"):
        bucket.mkdir(name)
    for path in manifest.parent.glob("*.mcap"):
        bucket.put(str(path), f"logs/{path.name}")
    remote = manifest.with_name("remote.toml")
    remote.write_text(manifest.read_text().replace('log = "', 'log = "s3://logs/'))
    ran = run_batch(remote, "s3://maps/week")
    found = {path.removeprefix("maps/week/"): bucket.cat(path) for path in bucket.find("maps")}
    server.stop()
    return ran, found


def compare(name: str, expected: dict[str, bytes], found: dict[str, bytes]) -> None:
    """Says which files differ; of a store's only maps are the same, since logs have other names."""
    if name == "store":
        expected, found = (
            {k: v for k, v in files.items() if not k.endswith((".json", ".txt", ".xml", ".html"))}
            for files in (expected, found)
        )
        expected = {k: v for k, v in expected.items() if k in found or not k.endswith(".db")}
    differ = differences(expected, found)
    kinds = Counter(Path(file).suffix for file in found)
    reported = ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items()))
    print(
        f"{name}: {len(found)} files ({reported}), {len(differ)} differ: {', '.join(differ) or '-'}"
    )


CASES: dict[str, Case] = {"killed": killed, "cluster": cluster, "store": store}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", choices=[[], *CASES], help="what to run")
    parser.add_argument("--logs", type=int, default=40)
    parser.add_argument("--broken", type=int, default=3)
    parser.add_argument("--keep", type=Path, help="folder for logs and maps")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        manifest = write_logs(folder, options.logs, options.broken)
        ran = run_batch(manifest, folder / "whole", "--again")
        whole = products(folder / "whole")
        print(ran.stdout)
        print(f"whole: exit code {ran.exit_code}, {ran.cpu_s:.0f} CPU s, {len(whole)} files")
        for case in options.cases or list(CASES):
            ran, found = CASES[case](manifest, options.logs)
            print(f"{case}: exit code {ran.exit_code}, {ran.cpu_s:.0f} CPU s of this machine's own")
            compare(case, whole, found)


if __name__ == "__main__":
    main()
