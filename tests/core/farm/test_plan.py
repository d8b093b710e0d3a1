"""Plans: the same tasks for the same inputs, names that are free, paths of other machines."""

from __future__ import annotations

import os

import pytest

from handfit_core.errors import InputError, OptionError
from handfit_core.farm.folder import Watch, files_in
from handfit_core.farm.inputs import expand
from handfit_core.farm.plan import Plan, make_plan, plans_in


@pytest.fixture
def photos(tmp_path):
    folder = tmp_path / "photos"
    folder.mkdir()
    for name in ("a", "b"):
        (folder / f"{name}.jpg").write_bytes(name.encode())
    return folder


def planned(folder, output, options=(), **more) -> Plan:
    return make_plan(expand(str(folder)), output, dict(options), **more)


def sealed(plan: Plan, name: str) -> None:
    task = plan.task(name)
    folder = plan.folder(task)
    output = folder.output
    output.mkdir(exist_ok=True)
    claim = Watch().claim(folder, task.id)
    assert claim is not None
    part = folder.part()
    (part / "result.txt").write_text(name)
    files = files_in(part, ["result.txt"])
    folder.take_in(part, files)
    folder.seal(task.id, {"status": "ok"}, files, 1.0)
    part.rmdir()
    claim.release()


def test_the_same_inputs_are_the_same_tasks_and_others_are_others(photos, tmp_path):
    out = tmp_path / "out"
    first = planned(photos, out)
    assert [t.name for t in first.tasks] == ["a", "b"]
    assert [t.id for t in planned(photos, out).tasks] == [t.id for t in first.tasks]
    assert planned(photos, out).path == first.path
    os.utime(photos / "a.jpg", (1, 1))
    assert planned(photos, out).path == first.path, "of small files the contents count, not the time"
    (photos / "a.jpg").write_bytes(b"another")
    changed = planned(photos, out)
    assert [a.id == b.id for a, b in zip(first.tasks, changed.tasks, strict=True)] == [False, True]
    other = planned(photos, out, {"smoothing": 2})
    assert not {t.id for t in other.tasks} & {t.id for t in changed.tasks}


def test_of_large_files_size_and_time_count(tmp_path):
    clip = tmp_path / "clip.mp4"
    with clip.open("wb") as stream:
        stream.truncate(50_000_000)
    (task,) = planned(clip, tmp_path / "out").tasks
    assert task.cost > 10
    os.utime(clip, (1, 1))
    (touched,) = planned(clip, tmp_path / "out").tasks
    assert touched.id != task.id


def test_the_same_input_twice_is_two_tasks(photos, tmp_path):
    plan = make_plan([*expand(str(photos / "a.jpg")), *expand(str(photos / "a.jpg"))], tmp_path / "out", {})
    assert [t.name for t in plan.tasks] == ["a", "a-2"]
    assert len(plan.by_id) == 2


def test_a_plan_comes_back_from_its_file(photos, tmp_path):
    plan = planned(photos, tmp_path / "out", {"capture": {"smoothing": 2.0}}, command=("blender", "-b"))
    assert plan.save() == plan.path
    (back,) = plans_in(tmp_path / "out")
    assert back == plan
    assert back.path == plan.path
    plan.path.write_text("{}")
    with pytest.raises(InputError, match="no plan that can be read"):
        Plan.load(plan.path)
    with pytest.raises(InputError, match="there is no plan in this folder"):
        plans_in(photos)


def test_results_keep_their_names_and_others_get_new_ones(photos, tmp_path):
    out = tmp_path / "out"
    first = planned(photos, out)
    first.save()
    sealed(first, "a")
    assert [t.name for t in planned(photos, out).tasks] == ["a", "b"], "it is done already"
    other = planned(photos, out, {"smoothing": 2})
    assert [t.name for t in other.tasks] == ["a-2", "b"], "results of other options stay"
    assert [t.name for t in planned(photos, out, {"smoothing": 2}, overwrite=True).tasks] == ["a", "b"]
    (out / "B").mkdir()
    (out / "B" / "of somebody").touch()
    assert [t.name for t in planned(photos, out).tasks] == ["a", "b-2"], "upper and lower case are equal"


def test_tasks_are_found_by_id_beginning_or_name(photos, tmp_path):
    plan = planned(photos, tmp_path / "out")
    task = plan.tasks[1]
    assert plan.task(task.id) == plan.task(task.id[:8]) == plan.task("b") == task
    with pytest.raises(OptionError, match="no task of the plan is called"):
        plan.task("c")


def test_paths_of_another_machine(photos, tmp_path):
    plan = planned(photos, tmp_path / "out", {"make": {"apply_to": f"{photos}/hero.blend"}})
    there = plan.mapped([(str(photos), "S:\\photos")])
    assert there.tasks[0].source == ("S:\\photos\\a.jpg",)
    assert there.options["make"]["apply_to"] == "S:\\photos\\hero.blend"
    assert there.tasks[0].id == plan.tasks[0].id
    assert there.path == plan.path
