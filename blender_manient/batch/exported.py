"""NAME.export.json: what was made of a take, with which options.

It lies beside the files and is written last, so that whoever gives the same command again makes only what is
missing.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from handfit_core.common.errors import OutputError
from handfit_core.common.files import shown
from handfit_core.tasks.record import (
    Result,
    missing_and_changed,
    read_record,
    said_of_changed,
    write_record,
)
from handfit_core.tasks.task import Task


class Exported:
    """The files that were made of one task's take."""

    def __init__(self, task: Task, output: Path, options: str) -> None:
        """`output`: the folder of all results. `options`: the key of those of the exports."""
        self.folder, self._prefix = task.folder(output), "" if task.flat else f"{task.name}/"
        self._path = self.folder / f"{task.name}.export.json"
        self._key = hashlib.sha256(f"{task.key} {options}".encode()).hexdigest()[:16]
        self.result = Result(task.shown, task.name, status="ok", id=task.key)
        """Has the `warnings`, `character` and `seconds` of the export"""
        self.formats: dict[str, dict[str, int]] = {}
        """By format, the files that are there, with their sizes"""
        self._of_others, self._changed = list[str](), list[str]()
        if (record := read_record(self._path)) is None:
            return
        missing, self._changed = missing_and_changed(self.folder, record)
        if record["key"] != self._key:
            self._of_others = [name for name in record["files"] if name not in missing]
            return
        self.result = Result.of_entry(record["result"])
        for fmt, names in record["formats"].items():
            if not any(name in missing for name in names):
                self.formats[fmt] = {name: record["files"][name] for name in names}

    def left(self, formats: Sequence[str], *, again: bool, overwrite: bool) -> list[str]:
        """The formats that have to be made, with `again` all of them. Raises OutputError where files of other
        options are there, unless `overwrite`."""
        if self._of_others and not overwrite:
            raise OutputError(
                f"{shown(self.folder / self._of_others[0])}: is there already, made with other options; "
                "--overwrite replaces it"
            )
        return [fmt for fmt in formats if again or fmt not in self.formats]

    def begin(self, formats: Sequence[str]) -> None:
        """Forget what was made of these formats; where nothing else is left, also what was said of it."""
        self.formats = {fmt: files for fmt, files in self.formats.items() if fmt not in formats}
        if not self.formats:
            self.result = replace(self.result, warnings=[], seconds=0.0, character=None)

    def save(self) -> None:
        """Write it. Raises OutputError."""
        self.result.warnings = list(dict.fromkeys(self.result.warnings))
        files = {name: size for sizes in self.formats.values() for name, size in sizes.items()}
        formats = {fmt: list(sizes) for fmt, sizes in self.formats.items()}
        write_record(self._path, self._key, self.result, files, formats=formats)

    def fill_in(self, entry: Result) -> None:
        """Add what was made to an entry of the report."""
        made = [name for files in self.formats.values() for name in files]
        entry.files += [f"{self._prefix}{name}" for name in made]
        entry.warnings += self.result.warnings
        if changed := [name for name in made if name in self._changed]:
            entry.warnings.append(said_of_changed(changed))
        entry.character = self.result.character
        entry.seconds = round(entry.seconds + self.result.seconds, 3)
