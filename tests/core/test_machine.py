"""What a process may use of its machine, as Linux tells it in files."""

from __future__ import annotations

import pytest

from handfit_core.machine import free_memory, usable_cores


@pytest.fixture
def system(tmp_path):
    """system({file: text}) -> a folder with /proc and /sys that hold these files."""

    def write(files: dict[str, str]):
        for name, text in files.items():
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="ascii")
        return tmp_path

    return write


MEMINFO = {"proc/meminfo": "MemTotal:       32000000 kB\nMemFree:  1 kB\nMemAvailable:   16000000 kB\n"}


def test_without_limits_the_machine_counts(system):
    root = system({**MEMINFO, "proc/self/cgroup": "0::/\n"})
    assert free_memory(root) == 16e6 * 1024
    assert usable_cores(root) == usable_cores(root / "nothing here") >= 1


def test_nobody_tells(tmp_path, monkeypatch):
    monkeypatch.setattr("sys.platform", "an old system")
    assert free_memory(tmp_path) is None


def test_groups_of_version_2_limit_all_below_them(system):
    group = "sys/fs/cgroup/slurm/job_1"
    root = system(
        {
            **MEMINFO,
            "proc/self/cgroup": "0::/slurm/job_1\n",
            f"{group}/memory.max": "max\n",
            f"{group}/memory.current": "1000\n",
            "sys/fs/cgroup/slurm/memory.max": "4000000000\n",
            "sys/fs/cgroup/slurm/memory.current": "3000000000\n",
            "sys/fs/cgroup/slurm/memory.stat": "anon 1\ninactive_file 500000000\nactive_file 7\n",
            f"{group}/cpu.max": "max 100000\n",
            "sys/fs/cgroup/slurm/cpu.max": "50000 100000\n",
        }
    )
    assert free_memory(root) == 1.5e9, "files that are only kept at hand are given back"
    assert usable_cores(root) == 1


def test_groups_of_version_1_seen_from_inside_a_container(system):
    root = system(
        {
            **MEMINFO,
            "proc/self/cgroup": "5:memory:/docker/0123\n3:cpu,cpuacct:/docker/0123\n0::/\n",
            "sys/fs/cgroup/memory/memory.limit_in_bytes": "2000000000\n",
            "sys/fs/cgroup/memory/memory.usage_in_bytes": "500000000\n",
            "sys/fs/cgroup/cpu,cpuacct/cpu.cfs_quota_us": "100000\n",
            "sys/fs/cgroup/cpu,cpuacct/cpu.cfs_period_us": "100000\n",
        }
    )
    assert free_memory(root) == 1.5e9
    assert usable_cores(root) == 1


def test_a_group_without_a_limit_is_none(system):
    root = system(
        {
            **MEMINFO,
            "proc/self/cgroup": "5:memory:/a\n3:cpu:/a\n",
            "sys/fs/cgroup/memory/a/memory.limit_in_bytes": "9223372036854771712\n",
            "sys/fs/cgroup/memory/a/memory.usage_in_bytes": "500000000\n",
            "sys/fs/cgroup/cpu/a/cpu.cfs_quota_us": "-1\n",
            "sys/fs/cgroup/cpu/a/cpu.cfs_period_us": "100000\n",
        }
    )
    assert free_memory(root) == 16e6 * 1024
    assert usable_cores(root) == usable_cores(root / "nothing here")
