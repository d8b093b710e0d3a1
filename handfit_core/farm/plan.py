"""What there is to do: a list of tasks in a file, the same list whenever the same things are asked for.

A task's id says what comes out of it: it is made of what the input's files hold (of large ones, of their
names, sizes and times), of the options and of this version. What has that id and is sealed need not be done
again, whoever did it.
"""

from __future__ import annotations

import contextlib
import datetime
import errno
import hashlib
import json
import os
import re
import sys
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache, cached_property
from itertools import islice
from pathlib import Path
from typing import Any, Final, Self

from handfit_core.doors import values
from handfit_core.doors.values import shortly
from handfit_core.errors import InputError, OptionError
from handfit_core.farm.folder import TaskFolder
from handfit_core.farm.inputs import Input
from handfit_core.files import is_file, is_folder, read_file, samples, shown, why, written_whole
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.opening import PHOTO_SUFFIXES, is_pattern, matching
from handfit_core.media.size_limit import claimed_frames
from handfit_core.version import __version__

FOLDER: Final = "plans"
"""Where plans lie in the folder of results"""

_FORMAT: Final = "manient-plan"
_VERSION: Final = 1
_LARGEST: Final = 1 << 27
"""bytes of a plan; 100 000 tasks have 23 MB"""
_MOST_ITEMS: Final = 8_000_000
_MOST_LISTS: Final = 2_000_000
"""Values in a plan's lists and objects, and lists and objects in it: in memory each takes up to 30 times what
it takes in the file"""
_AWAY: Final = (errno.ENOENT, errno.ESTALE, errno.EIO, errno.ETIMEDOUT, errno.ENOTCONN)
"""What systems say of a file on a disk that is not here"""
_READ_WHOLE: Final = 4 << 20
"""bytes that the files of one input may have together for their contents to be compared; of larger ones
names, sizes and times are, since reading a thousand clips costs hours"""
_READ_NAMED: Final = 64 << 20
"""The same of each file that the options name, such as a hand model: of these there are few, and machines may
have copies of their own, whose times differ"""
_MOST_FILES: Final = 100_000
"""of a folder and its folders that are looked at"""
_BYTES_OF_FRAME: Final = 15_000
"""of a video whose header does not tell its frames"""
_FRAME: Final = 0.02
_BESIDE: Final = 1.0
"""seconds for a frame and for what is done once, for the order of tasks and for guesses of the time left"""
_LONGEST: Final = 1e9
"""seconds that a task is guessed to take at most, thirty years: farms' limits of time follow from it"""
FINDING: Final = 0.65
"""What finding the hands is of a clip's cost"""


class PlanGone(InputError):
    """There is no plan where one is looked for; its disk may come back, or be elsewhere."""


@dataclass(frozen=True)
class Task:
    """One input, and what comes out of it."""

    id: str
    name: str
    """of its results, and of their folder"""
    shown: str
    """The input, for people"""
    source: tuple[str, ...] = ()
    """What to capture: full paths, or a pattern"""
    take: str = ""
    """The take to use instead"""
    error: str = ""
    """Why it cannot even be tried"""
    made_of: str = ""
    """`fingerprint` of the files that it was planned with"""
    cost: float = 0.0
    """seconds that it may take; a guess, good for comparing tasks"""
    part: str = ""
    """The frames of the clip in which only hands are to be found, for the task `of` that id"""
    of: str = ""
    needs: tuple[str, ...] = ()
    """The ids of such tasks, which must be done before"""

    @classmethod
    def of_entry(cls, entry: Mapping[str, Any]) -> Self:
        """From what `asdict` made of one, as JSON gives it back. Raises ValueError or TypeError."""
        known: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in entry.items()}
        for name, value in known.items():
            if name == "cost":
                values.number(name, value, 0.0, _LONGEST)
                continue
            texts = value if isinstance(value, tuple) and name in ("source", "needs") else (value,)
            for text in texts:
                values.path(f"{name} of a task", text)
        return cls(**known)


@dataclass(frozen=True)
class Plan:
    """Tasks that have their options and their folder of results in common."""

    output: Path
    """The folder of results"""
    tasks: tuple[Task, ...]
    options: Mapping[str, Any]
    """What is to be done of every input, as JSON holds it; whoever does the tasks understands them"""
    flat: bool = False
    """Whether all results lie in one folder"""
    overwrite: bool = False
    """Whether results replace those of other tasks that have their name"""
    files: tuple[tuple[str, str], ...] = ()
    """Those that the options name, folders too, and what each held when the plan was made, as `check_files`
    compares it"""
    command: tuple[str, ...] = ()
    """What does tasks of this plan on the machine that made it, but for the name of the command"""
    made_by: str = __version__
    """The version that made it"""
    created: str = field(default_factory=lambda: datetime.datetime.now(datetime.UTC).isoformat())

    @cached_property
    def path(self) -> Path:
        """The plan's file, named by what there is to do."""
        names = json.dumps([self.flat, self.overwrite, [[task.id, task.name] for task in self.tasks]])
        return self.output / FOLDER / f"{hashlib.sha256(names.encode()).hexdigest()[:12]}.json"

    @cached_property
    def by_id(self) -> Mapping[str, Task]:
        """Every task by its id."""
        return {task.id: task for task in self.tasks}

    def folder(self, task: Task) -> TaskFolder:
        """Where the results of a task go."""
        return TaskFolder(self.output, task.name, self.flat)

    def is_sealed(self, id: str) -> bool:
        """Whether the task of that id is done."""
        return self.folder(self.by_id[id]).sealed(id) is not None

    def part_file(self, id: str) -> Path:
        """What the task of that id finds in its part of a clip."""
        task = self.by_id[id]
        return self.folder(task).path / f"{task.name}.npz"

    def task(self, id: str) -> Task:
        """The task of an id, or of a beginning or a name that only one has. Raises OptionError."""
        found = [t for t in self.tasks if id in (t.id, t.name) or (len(id) > 5 and t.id.startswith(id))]
        if len(found) != 1:
            several = "several tasks" if found else "no task"
            raise OptionError(f"{shown(self.path)}: {several} of the plan is called {shown(id)}")
        return found[0]

    def chosen(self, text: str) -> list[Task]:
        """The tasks that a text names: one as `task` finds it, or several by their numbers in the plan, from
        1 on, as in #1-9,12. Raises OptionError."""
        if re.fullmatch(r"#\d+(-\d+)?(,\d+(-\d+)?)*", text) and text not in (t.name for t in self.tasks):
            ends = [(int(a), int(b or a)) for a, b in re.findall(r"(\d+)(?:-(\d+))?", text)]
            if all(1 <= first <= last <= len(self.tasks) for first, last in ends):
                return [task for first, last in ends for task in self.tasks[first - 1 : last]]
        return [self.task(text)]

    def save(self) -> Path:
        """Write it; returns its file. Raises OutputError."""
        with written_whole(self.path) as beside:
            beside.write_text(json.dumps(self.content(), indent=1), encoding="ascii")
        return self.path

    def content(self) -> dict[str, Any]:
        """What its file holds."""
        content = {"format": _FORMAT, "version": _VERSION, **asdict(self)}
        del content["output"]
        content["tasks"] = [{k: v for k, v in task.items() if v} for task in content["tasks"]]
        return content

    @classmethod
    def load(cls, path: Path) -> Plan:
        """Read a plan's file. Raises InputError."""
        try:
            data = read_file(path, _LARGEST)
            if data.count(b",") > _MOST_ITEMS or data.count(b"[") + data.count(b"{") > _MOST_LISTS:
                raise ValueError("it lists more than any plan")
            plan = cls.of_content(json.loads(data), path)
            del data
            json.dumps(plan.options, allow_nan=False)
            plan._check_parts()
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            reason = why(error) if isinstance(error, OSError) else shortly(str(error))
            gone = isinstance(error, OSError) and error.errno in _AWAY
            kind = PlanGone if gone else InputError
            raise kind(f"{shown(path)}: this is no plan that can be read ({reason})") from error
        return plan

    @classmethod
    def of_content(cls, content: Mapping[str, Any], path: Path) -> Plan:
        """The plan of the file `path`, which holds that. Raises ValueError, KeyError or TypeError."""
        if not isinstance(content["options"], dict) or not isinstance(content["tasks"], list):
            raise ValueError("it has no options or no tasks")
        if content["format"] != _FORMAT or content["version"] != _VERSION:
            raise ValueError(f"it is no plan of version {_VERSION}")
        tasks = tuple(Task.of_entry(task) for task in content["tasks"])
        for task in tasks:
            if task.name != _as_folder(Path(task.name).name):
                raise ValueError(f"{shortly(task.name)} is no name of a task")
        plan = cls(
            path.absolute().parent.parent,
            tasks,
            content["options"],
            bool(content["flat"]),
            bool(content["overwrite"]),
            tuple((values.path("files", path), str(held)) for path, held in content.get("files", ())),
            tuple(values.path("command", word) for word in content["command"]),
            values.text("made_by", content["made_by"], 100),
            values.text("created", content["created"], 100),
        )
        vars(plan)["path"] = path.absolute()
        return plan

    def _check_parts(self) -> None:
        """Raise ValueError where a task that another one needs is not there, or is no part of its clip: what
        waited for itself would never be done."""
        for task in self.tasks:
            for id in (id for id in (task.of, *task.needs) if id):
                if id not in self.by_id:
                    raise ValueError(f"there is no task {shortly(id)}, which another one needs")
            if any(self.by_id[id].of != task.id or self.by_id[id].needs for id in task.needs):
                raise ValueError(f"the task {shortly(task.name)} needs what is no part of its clip")

    def mapped(self, places: Sequence[tuple[str, str]]) -> Plan:
        """The plan with other beginnings of paths: what is called `places[i][0]` where it was made is called
        `places[i][1]` here. Only whole names of folders count, and the first that fits."""
        if not places:
            return self

        def here(value: Any) -> Any:
            if isinstance(value, str):
                for there, now in places:
                    if (rest := _below(value, there)) is not None:
                        if _is_windows(there) != _is_windows(now):
                            wrong, right = ("\\", "/") if _is_windows(there) else ("/", "\\")
                            rest = rest.replace(wrong, right)
                        return now.rstrip("/\\" if _is_windows(now) else "/") + rest
            if isinstance(value, Mapping):
                return {key: here(inner) for key, inner in value.items()}
            return type(value)(map(here, value)) if isinstance(value, list | tuple) else value

        tasks = tuple(replace(t, source=here(t.source), take=here(t.take)) for t in self.tasks)
        plan = replace(self, tasks=tasks, options=here(self.options), files=here(self.files))
        vars(plan)["path"] = self.path
        return plan


def places_of(text: str) -> list[tuple[str, str]]:
    """What `Plan.mapped` takes, of THERE=HERE or of a file with Open Job Description's path mapping rules.
    Raises OptionError."""
    file = Path(text)
    if not file.is_file() and "=" in text:
        there, _, now = text.partition("=")
        return [(there, now)]
    try:
        rules = json.loads(read_file(file, _LARGEST)).get("path_mapping_rules", [])
        return [(str(rule["source_path"]), str(rule["destination_path"])) for rule in rules]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise OptionError(
            f"{shown(text)} says of no paths what they are called here; give THERE=HERE, or a file with path "
            "mapping rules of Open Job Description"
        ) from error


def _is_windows(path: str) -> bool:
    return "\\" in path or path[1:2] == ":"


def _below(path: str, folder: str) -> str | None:
    """What follows the folder in a path, with the slash before it; None where it is not in that folder."""
    windows = _is_windows(folder)
    folder = folder.rstrip("/\\" if windows else "/")
    start, rest = path[: len(folder)], path[len(folder) :]

    def plain(text: str) -> str:
        return text.replace("\\", "/").lower() if windows else text

    return rest if plain(start) == plain(folder) and plain(rest[:1]) in ("", "/") else None


def plans_in(path: Path) -> list[Plan]:
    """The plan of a file, or all plans of a folder of results that can be read, the oldest first; a warning
    on stderr tells of others. Raises InputError where there is none."""
    if not path.is_dir():
        return [Plan.load(path)]
    found = []
    for file in sorted((path / FOLDER).glob("[!.]*.json")):
        try:
            found.append(Plan.load(file))
        except InputError as error:
            warn_once(f"{error}; it is passed over")
    if not found:
        raise PlanGone(f"{shown(path)}: there is no plan in this folder; make one with the command plan")
    return sorted(found, key=lambda plan: plan.created)


@cache
def warn_once(text: str) -> None:
    """Say on stderr what does not end a batch."""
    print(f"warning: {text}", file=sys.stderr)


def make_plan(
    inputs: Iterable[Input],
    output: Path,
    options: Mapping[str, Any],
    *,
    files: Sequence[str] = (),
    flat: bool = False,
    overwrite: bool = False,
    command: Sequence[str] = (),
    parts_of: Callable[[Input], Sequence[str]] = lambda _: (),
    frames: FrameRange | None = None,
) -> Plan:
    """A task for each input. `files`: those that the options name, and folders; what they hold counts too.
    `parts_of` gives the ranges of frames in which the hands of an input are found by tasks of their own, if
    any. `frames`: those that the options want of a clip.

    An input's own name is its results' name, unless that is taken: by another input, or by results of other
    tasks, which `overwrite` replaces. Then it gets -2, -3, ..., upper and lower case being equal.
    """
    held = [fingerprint(_files_at(file), _READ_NAMED) for file in files]
    common = json.dumps([__version__, options, held], sort_keys=True)
    there = {path.name.lower(): path.name for path in output.iterdir()} if output.is_dir() else {}
    taken = set() if flat else {FOLDER, "report.json", "overview.html"}
    first: dict[str, int] = {}
    """By name, the lowest number that may be free"""
    owned: dict[tuple[str, str], int] = {}
    """By name and id, the number under which results of that task lie"""
    ids: set[str] = set()
    tasks = []

    def owner(folder: TaskFolder) -> str | None:
        if folder.name.lower() in taken:
            return ""
        if flat or overwrite:
            return None
        return folder.owner if there.get(folder.name.lower(), folder.name) == folder.name else ""

    def free(name: str, id: str) -> str:
        """The name, or the first of those with numbers, that is free for that task."""
        known = owned.get((name.lower(), id))
        number = known or first.get(name.lower(), 1)
        while known is None:
            whose = owner(TaskFolder(output, _numbered(name, number), flat))
            if whose is None or whose == id:
                break
            owned[name.lower(), whose] = number
            number += 1
        first[name.lower()] = max(first.get(name.lower(), 1), number + (known is None))
        taken.add(_numbered(name, number).lower())
        return _numbered(name, number)

    for each in inputs:
        task = _task(each, common, ids, frames or FrameRange())
        ids.add(task.id)
        name = _as_folder(task.name)
        task = replace(task, name=free(name, task.id))
        parts = [replace(part, name=free(part.name, part.id)) for part in _parts(task, parts_of(each))]
        rest = round(task.cost - sum(part.cost for part in parts), 3)
        tasks += [*parts, replace(task, needs=tuple(part.id for part in parts), cost=rest)]
    named = tuple(zip(map(str, files), held, strict=True))
    return Plan(output.absolute(), tuple(tasks), options, flat, overwrite, named, tuple(command))


def _as_folder(name: str) -> str:
    """An input's name, or another where a folder of that name would not lie in the folder of results."""
    return name if name not in ("", ".", "..") else "input"


def _numbered(name: str, number: int) -> str:
    return name if number == 1 else f"{name}-{number}"


def _task(each: Input, common: str, ids: Collection[str], frames: FrameRange) -> Task:
    """An input's task, whose name may be taken; `ids` are those of other ones."""
    files = [each.take] if each.take else files_of(each.source)
    made_of = fingerprint(files)
    what = [common, each.name, made_of, bool(each.take), each.error, each.shown if not files else ""]
    again = 0
    while (number := hashlib.sha256(json.dumps([*what, again]).encode()).hexdigest()[:16]) in ids:
        again += 1  # the same input a second time
    source = tuple(str(Path(part).absolute()) for part in each.source)
    take = str(each.take.absolute()) if each.take else ""
    cost = _BESIDE + (0.0 if each.take else _FRAME * _frames(files, frames))
    cost = min(round(cost, 3), _LONGEST)
    return Task(number, each.name, each.shown, source, take, each.error, made_of, cost)


def _parts(task: Task, ranges: Sequence[str]) -> Iterable[Task]:
    """The tasks that find the hands in parts of a clip."""
    for number, frames in enumerate(ranges, 1):
        yield replace(
            task,
            id=hashlib.sha256(f"{task.id} {frames}".encode()).hexdigest()[:16],
            name=f"{task.name}.part{number}",
            shown=f"{task.shown}, frames {frames}",
            cost=round(FINDING * task.cost / len(ranges), 3),
            part=frames,
            of=task.id,
        )


def files_of(source: Sequence[str]) -> list[Path]:
    """The files of an input: of a pattern, those that match it now."""
    (first, *_) = source or ("",)
    if len(source) == 1 and is_pattern(first) and not Path(first).exists():
        return matching(Path(first))[0]
    return _files_at(first) if len(source) == 1 else [Path(part) for part in source]


def _files_at(path: str) -> list[Path]:
    """A file, or what lies in another program's folder and its folders, in the same order on any disk; links
    to folders are not followed."""
    if not is_folder(path):
        return [Path(path)]
    below = (Path(where, name) for where, _, names in os.walk(path) for name in names)
    return sorted(islice(filter(is_file, below), _MOST_FILES))


def check_files(named: Iterable[Sequence[str]]) -> None:
    """Raise OptionError where one of `Plan.files` holds something else than when the plan was made. Of one
    that is not there, who needs it says so."""
    for path, held in named:
        if _size_and_time(Path(path))[0] >= 0 and fingerprint(_files_at(path), _READ_NAMED) != held:
            raise OptionError(
                f"{shown(path)}: holds something else than when the batch was planned; bring back what it "
                "held, or start the batch again, which then does everything anew"
            )


def fingerprint(files: Sequence[Path], read_whole: int = _READ_WHOLE) -> str:
    """What files hold, in short: the same for the same, and another once one of them has changed, as far as
    that can be told without reading those that have more than `read_whole` bytes together."""
    found = [(file.name, *_size_and_time(file)) for file in files]
    digest = hashlib.sha256()
    if sum(size for _, size, _ in found) <= read_whole and all(size >= 0 for _, size, _ in found):
        for file in files:
            try:
                digest.update(read_file(file, read_whole))
            except (OSError, ValueError) as error:
                digest.update(str(error).encode("utf-8", "replace"))
        found = [(name, size, 0) for name, size, _ in found]
    else:
        with contextlib.suppress(OSError):
            for sample in samples(files, [size for _, size, _ in found]):
                digest.update(sample)
    digest.update(json.dumps(found).encode())
    return digest.hexdigest()[:32]


def _size_and_time(file: Path) -> tuple[int, int]:
    """Bytes and milliseconds, which all file systems can hold; -1, 0 where there is no such file."""
    try:
        found = file.stat()
    except (OSError, ValueError):
        return -1, 0
    return found.st_size, found.st_mtime_ns // 1_000_000


def _frames(files: Sequence[Path], wanted: FrameRange) -> float:
    """How many frames of some files may be wanted; headers of videos are believed."""
    there = 0.0
    for file in files:
        claimed = 1
        if file.suffix.lower() not in PHOTO_SUFFIXES:
            claimed = claimed_frames(file) or _size_and_time(file)[0] / _BYTES_OF_FRAME
        there += max(claimed, 0)
    return len(wanted.within(1, round(there))) or there
