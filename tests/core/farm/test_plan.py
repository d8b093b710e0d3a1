"""Plans: the same tasks for the same inputs, names that are free, paths of other machines."""

from __future__ import annotations

import argparse
import json
import os

import pytest

from handfit_core.errors import InputError, OptionError
from handfit_core.farm.collect import Report
from handfit_core.farm.commands import given_plans
from handfit_core.farm.folder import TaskFolder, Watch, files_in
from handfit_core.farm.inputs import Input, expand
from handfit_core.farm.plan import Plan, Task, check_files, files_of, make_plan, places_of, plans_in


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
    (part / "result.txt").write_bytes(os.fsencode(name))
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


@pytest.mark.parametrize(
    ("there", "here", "path", "expected"),
    [
        ("/mnt/a", "/vol/b", "/mnt/a/x.mp4", "/vol/b/x.mp4"),
        ("/mnt/a/", "/vol/b/", "/mnt/a/x.mp4", "/vol/b/x.mp4"),
        ("/mnt/a", "/vol/b", "/mnt/a", "/vol/b"),
        ("/mnt/a", "/vol/b", "/mnt/ab/x.mp4", "/mnt/ab/x.mp4"),
        ("/mnt/a", "/vol/b", "/MNT/a/x.mp4", "/MNT/a/x.mp4"),
        ("/mnt/a", "/vol/b", "/mnt/a/o\\dd.mp4", "/vol/b/o\\dd.mp4"),
        ("/", "/vol", "/x.mp4", "/vol/x.mp4"),
        ("/mnt/a", "S:\\b", "/mnt/a/c/x.mp4", "S:\\b\\c\\x.mp4"),
        ("/mnt/a", "S:/", "/mnt/a/c/x.mp4", "S:\\c\\x.mp4"),
        ("Z:\\Shots", "/vol/b", "z:\\shots\\Day 1\\x.mp4", "/vol/b/Day 1/x.mp4"),
        ("Z:/shots/", "/vol/b", "Z:\\shots\\x.mp4", "/vol/b/x.mp4"),
        ("Z:\\", "/vol", "Z:\\x.mp4", "/vol/x.mp4"),
        ("\\\\server\\share", "/vol", "\\\\SERVER\\share\\x.mp4", "/vol/x.mp4"),
        ("Z:\\İ", "/vol", "Z:\\İ\\x.mp4", "/vol/x.mp4"),
    ],
)
def test_beginnings_of_paths_are_whole_folders(tmp_path, there, here, path, expected):
    plan = Plan(tmp_path, (Task("0" * 16, "x", "x.mp4", (path,)),), {})
    assert plan.mapped(places_of(f"{there}={here}")).tasks[0].source == (expected,)


def test_path_mapping_rules_of_a_farm(tmp_path):
    rules = tmp_path / "rules=.json"
    names = ("source_path_format", "source_path", "destination_path")
    content = [
        dict(zip(names, rule, strict=True)) for rule in (("WINDOWS", "Z:\\a", "/b"), ("POSIX", "/c", "/d"))
    ]
    rules.write_text(json.dumps({"version": "pathmapping-1.0", "path_mapping_rules": content}))
    assert places_of(str(rules)) == [("Z:\\a", "/b"), ("/c", "/d")]
    rules.write_text("{}")  # what Open Job Description writes where there are none
    assert places_of(str(rules)) == []
    for wrong in ("[]", "nothing", '{"path_mapping_rules": [{}]}', '{"path_mapping_rules": 1}'):
        rules.write_text(wrong)
        with pytest.raises(OptionError, match="give THERE=HERE"):
            places_of(str(rules))
    with pytest.raises(OptionError, match="give THERE=HERE"):
        places_of(str(tmp_path / "gone"))


def test_paths_of_another_machine(photos, tmp_path):
    plan = planned(photos, tmp_path / "out", {"make": {"apply_to": f"{photos}/hero.blend"}})
    there = plan.mapped([(str(photos), "S:\\photos")])
    assert there.tasks[0].source == ("S:\\photos\\a.jpg",)
    assert there.options["make"]["apply_to"] == "S:\\photos\\hero.blend"
    assert there.tasks[0].id == plan.tasks[0].id
    assert there.path == plan.path


def test_equal_names_are_looked_at_once(tmp_path, monkeypatch):
    """However many there are, and whoever's results lie there."""
    clips = []
    for number in range(30):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / "rgb.jpg").write_bytes(bytes([number]))
        clips += expand(str(folder / "rgb.jpg"))
    out = tmp_path / "out"
    first = make_plan(clips, out, {})
    first.save()
    for task in first.tasks:
        sealed(first, task.name)
    looks: list[str] = []
    owner = TaskFolder.owner.fget
    assert owner is not None
    monkeypatch.setattr(TaskFolder, "owner", property(lambda self: looks.append(self.name) or owner(self)))
    again = make_plan(clips, out, {})
    assert [t.name for t in again.tasks] == [t.name for t in first.tasks]
    assert len(looks) == 30
    looks.clear()
    other = make_plan(clips, out, {"smoothing": 2})
    assert [t.name for t in other.tasks] == [f"rgb-{number}" for number in range(31, 61)]
    assert len(looks) == 60
    backwards = make_plan(clips[::-1], out, {})
    assert [t.name for t in backwards.tasks] == [t.name for t in first.tasks][::-1]


def test_a_result_that_somebody_has_changed_is_his(photos, tmp_path):
    plan = planned(photos, tmp_path / "out")
    plan.save()
    sealed(plan, "a")
    task = plan.task("a")
    folder = plan.folder(task)
    assert folder.sealed(task.id) is not None
    (folder.path / "result.txt").write_text("changed by hand")
    seal = folder.sealed(task.id)
    assert seal is not None
    assert "result.txt: changed since the batch wrote it" in seal["result"]["warnings"][0]
    (folder.path / "result.txt").unlink()
    assert folder.sealed(task.id) is None


def test_parts_have_names_that_no_other_input_has(tmp_path):
    clips = []
    for name in ("talk.part1", "talk", "talk.part2"):
        (tmp_path / f"{name}.mp4").write_bytes(name.encode())
        clips += expand(str(tmp_path / f"{name}.mp4"))

    def parts_of(each):
        return ["1-480", "481-"] if each.name == "talk" else []

    plan = make_plan(clips, tmp_path / "out", {}, parts_of=parts_of)
    assert len({task.name for task in plan.tasks}) == len(plan.tasks) == 5
    assert {task.name for task in plan.tasks if task.of} == {"talk.part1-2", "talk.part2"}


def test_large_files_of_equal_size_and_time_are_others(tmp_path):
    ids = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        clip = tmp_path / name / "clip.mp4"
        with clip.open("wb") as stream:
            stream.write(name.encode())
            stream.truncate(50_000_000)
        os.utime(clip, (1, 1))
        (task,) = planned(clip, tmp_path / "out").tasks
        ids.append(task.id)
    assert ids[0] != ids[1]


@pytest.mark.parametrize("size", [3, 5_000_000], ids=["small", "large"])
def test_what_files_of_the_options_hold_counts(photos, tmp_path, size):
    model = tmp_path / "MANO_RIGHT.pkl"
    model.write_bytes(b"1" * size)
    first = planned(photos, tmp_path / "out", files=[str(model)])
    first.save()
    (back,) = plans_in(tmp_path / "out")
    assert back == first
    os.utime(model, (1, 1))
    check_files(back.files)
    assert planned(photos, tmp_path / "out", files=[str(model)]).tasks[0].id == first.tasks[0].id
    model.write_bytes(b"1" * (size - 1) + b"2")
    with pytest.raises(OptionError, match=r"MANO_RIGHT\.pkl: holds something else than when the batch was"):
        check_files(back.files)
    assert planned(photos, tmp_path / "out", files=[str(model)]).tasks[0].id != first.tasks[0].id
    model.write_bytes(b"1" * size)
    check_files(back.files)
    model.unlink()
    check_files(back.files)  # who needs it says that it is gone
    moved = back.mapped([(str(tmp_path), str(tmp_path / "there"))])
    assert [path for path, _ in moved.files] == [str(tmp_path / "there" / "MANO_RIGHT.pkl")]


def test_what_lies_in_folders_of_a_folder_counts(photos, tmp_path):
    """Of another program's folder, be it the input or named by the options."""
    nested = tmp_path / "hawor" / "cam_space" / "0" / "0_9.json"
    nested.parent.mkdir(parents=True)
    nested.write_text("1")
    folder = tmp_path / "hawor"
    assert files_of([str(folder)]) == [nested]

    def ids() -> tuple[str, str]:
        as_input = Input("hawor", "hawor", (str(folder),))
        plan = make_plan([as_input], tmp_path / "out", {})
        return plan.tasks[0].id, planned(photos, tmp_path / "out", files=[str(folder)]).tasks[0].id

    first, named = ids(), planned(photos, tmp_path / "out", files=[str(folder)])
    check_files(named.files)
    assert ids() == first
    nested.write_text("2")
    assert not set(ids()) & set(first)
    with pytest.raises(OptionError, match="hawor: holds something else"):
        check_files(named.files)
    nested.write_text("1")
    check_files(named.files)


def test_an_input_that_was_renamed_stands_in_the_report_once(photos, tmp_path):
    out = tmp_path / "out"
    planned(photos, out).save()
    (photos / "b.jpg").rename(photos / "c.jpg")
    report = Report(plans_in(out))
    report.look()
    assert [r.name for r in report.results] == ["a", "b"], "it is the only plan's"
    planned(photos, out).save()
    report = Report(plans_in(out))
    report.look()
    assert sorted(r.name for r in report.results) == ["a", "c"]


def broken(plan: Plan, change) -> None:
    content = json.loads(plan.path.read_text())
    change(content)
    plan.path.write_text(json.dumps(content))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda c: c["tasks"][0].update(needs=["nobody"]), "nobody"),
        (lambda c: c["tasks"][0].update(of="nobody"), "nobody"),
        (lambda c: c["tasks"][0].update(cost="much"), "cost must be a finite number.*much"),
        (lambda c: c["tasks"][0].update(cost=float("nan")), "cost must be a finite number.*nan"),
        (lambda c: c["tasks"][0].update(cost=1e308), "cost must be a finite number.*1e\\+308"),
        (lambda c: c["tasks"][0].update(source="a.mp4", shown=[1]), "shown of a task"),
        (lambda c: c["tasks"][0].update(source=[1]), "source of a task"),
        (lambda c: c["tasks"][0].update(error="a\0b"), "error of a task"),
        (lambda c: c.update(options={"smoothing": float("inf")}), "JSON"),
        (lambda c: c.update(options=[]), "options"),
        (lambda c: c.update(tasks={}), "tasks"),
    ],
)
def test_a_strange_plan_is_refused_with_what_is_strange(photos, tmp_path, change, said):
    plan = planned(photos, tmp_path / "out", {"smoothing": 1})
    plan.save()
    broken(plan, change)
    with pytest.raises(InputError, match=f"no plan that can be read .*{said}"):
        Plan.load(plan.path)


def test_files_that_are_no_plans_do_not_stand_in_the_way_of_those_that_are(photos, tmp_path, capsys):
    plan = planned(photos, tmp_path / "out")
    plan.save()
    strange = plan.path.with_name("job.json")
    strange.write_text("{}")
    for _ in range(2):
        assert [each.path for each in plans_in(tmp_path / "out")] == [plan.path]
    assert capsys.readouterr().err.count("job.json") == 1, "a warning, once"
    with pytest.raises(InputError, match=r"job\.json"):
        plans_in(strange)
    plan.path.unlink()
    with pytest.raises(InputError, match="no plan in this folder"):
        plans_in(tmp_path / "out")


def test_plans_of_other_versions_are_done_by_other_versions(photos, tmp_path, capsys):
    here = argparse.Namespace(map=[], plan=tmp_path / "out")
    old = planned(photos, tmp_path / "out", {"smoothing": 1})
    old.save()
    broken(old, lambda content: content.update(made_by="0.0.1"))
    for here.plan in (tmp_path / "out", old.path):
        with pytest.raises(OptionError, match=r"made by version 0\.0\.1.*the same version on all machines"):
            given_plans(here)
    new = planned(photos, tmp_path / "out")
    new.save()
    here.plan = tmp_path / "out"
    assert [plan.path for plan in given_plans(here)] == [new.path]
    assert "0.0.1" in capsys.readouterr().err


def test_names_that_are_no_folders_of_their_own(tmp_path):
    """A video may be called as the plans' folder, as the folder above, or with what is no UTF-8."""
    out, shots = tmp_path / "out", tmp_path / "shots"
    shots.mkdir()
    for name in (b"plans.mp4", b"...mp4", b"report.json.mp4", b"Overview.HTML.mp4", b"\xff.mp4", b"a\nb.mp4"):
        (shots / os.fsdecode(name)).write_bytes(name)
    plan = make_plan([*expand(str(shots)), *expand(str(shots / "...mp4"))], out, {})
    names = {task.name for task in plan.tasks}
    assert not {name.lower() for name in names} & {"plans", "report.json", "overview.html", "..", ""}
    assert all((out / name).parent == out for name in names)
    plan.save()
    for task in plan.tasks:
        sealed(plan, task.name)
    (back,) = plans_in(out)
    assert back.tasks == plan.tasks
    report = Report([back])
    report.look()
    report.write()
    assert [r.status for r in report.results] == ["ok"] * 6
    told = json.loads((out / "report.json").read_text(encoding="utf-8"))["inputs"]
    assert len(told) == 6
    text = plan.path.read_text().replace('"name": "plans-2"', '"name": "../outside"')
    plan.path.write_text(text)
    with pytest.raises(InputError, match="no name of a task"):
        Plan.load(plan.path)
