"""What a process may use of its machine, as Linux tells it in files."""

import pytest

from handfit_core.common.machine import free_memory, usable_cores

FREE = 16e6 * 1024
MACHINE = {"proc/meminfo": "MemTotal:       32000000 kB\nMemFree:  1 kB\nMemAvailable:   16000000 kB\n"}
V2 = "sys/fs/cgroup/slurm"
V1 = "sys/fs/cgroup"
NO_LIMIT = {"proc/self/cgroup": "0::/\n"}
# Groups of version 2 limit all below them; files that are only kept at hand are given back.
GROUPS = {
    "proc/self/cgroup": "0::/slurm/job_1\n",
    f"{V2}/job_1/memory.max": "max\n",
    f"{V2}/job_1/memory.current": "1000\n",
    f"{V2}/memory.max": "4000000000\n",
    f"{V2}/memory.current": "3000000000\n",
    f"{V2}/memory.stat": "anon 1\ninactive_file 500000000\nactive_file 7\n",
    f"{V2}/job_1/cpu.max": "max 100000\n",
    f"{V2}/cpu.max": "50000 100000\n",
}
CONTAINER = {
    "proc/self/cgroup": "5:memory:/docker/0123\n3:cpu,cpuacct:/docker/0123\n0::/\n",
    f"{V1}/memory/memory.limit_in_bytes": "2000000000\n",
    f"{V1}/memory/memory.usage_in_bytes": "500000000\n",
    f"{V1}/cpu,cpuacct/cpu.cfs_quota_us": "100000\n",
    f"{V1}/cpu,cpuacct/cpu.cfs_period_us": "100000\n",
}
UNLIMITED = {
    "proc/self/cgroup": "5:memory:/a\n3:cpu:/a\n",
    f"{V1}/memory/a/memory.limit_in_bytes": "9223372036854771712\n",
    f"{V1}/memory/a/memory.usage_in_bytes": "500000000\n",
    f"{V1}/cpu/a/cpu.cfs_quota_us": "-1\n",
    f"{V1}/cpu/a/cpu.cfs_period_us": "100000\n",
}


@pytest.mark.parametrize(
    ("files", "memory", "cores"),
    [(NO_LIMIT, FREE, None), (GROUPS, 1.5e9, 1), (CONTAINER, 1.5e9, 1), (UNLIMITED, FREE, None)],
    ids=["the machine", "version 2", "version 1 in a container", "version 1 without limits"],
)
def test_limits(files, memory, cores, tmp_path):
    for name, text in (MACHINE | files).items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="ascii")
    assert free_memory(tmp_path) == memory
    assert usable_cores(tmp_path) == (cores or usable_cores(tmp_path / "nothing here"))


def test_nobody_tells(tmp_path, monkeypatch):
    monkeypatch.setattr("sys.platform", "an old system")
    assert free_memory(tmp_path) is None
