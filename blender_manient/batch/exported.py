"""NAME.export.json: what was made of a take, with which options.

It lies beside the files and is written last, so that whoever gives the same command again makes only what is
missing.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

from handfit_core.errors import OutputError
from handfit_core.files import shown
from handfit_core.tasks.record import missing_and_changed, read_record, write_record
from handfit_core.tasks.report import Result
from handfit_core.tasks.task import Task


class Exported:
    """The files that were made of one task's take."""

    def __init__(self, task: Task, output: Path, options: str) -> None:
        """`output`: the folder of all results. `options`: the key of those of the exports."""
        self.folder, self._prefix = task.folder(output), "" if task.flat else f"{task.name}/"
        self._path = self.folder / f"{task.name}.export.json"
        self._key = hashlib.sha256(f"{task.key} {options}".encode()).hexdigest()[:16]
        self._of_others: list[str] = []
        record = read_record(self._path) or {"key": "", "files": {}, "result": {}}
        missing, self._changed = missing_and_changed(self.folder, record)
        if record["key"] != self._key:
            self._of_others = [name for name in record["files"] if name not in missing]
            record = {"files": {}, "result": {}}
        self.result = Result.of_entry(record["result"])
        """Has the `warnings`, `character` and `seconds` of the export"""
        self.formats: dict[str, dict[str, int]] = {}
        """By format, the files that are there, with their sizes"""
        made = record["result"].get("formats")
        for fmt, files in made.items() if isinstance(made, dict) else ():
            if isinstance(files, dict) and not any(name in missing for name in files):
                self.formats[fmt] = files

    def left(self, formats: Sequence[str], *, again: bool, overwrite: bool) -> list[str]:
        """The formats that have to be made, with `again` all of them. Raises OutputError where files of other
        options are there, unless `overwrite`."""
        if self._of_others and not overwrite:
            raise OutputError(
                f"{shown(self.folder / self._of_others[0])}: is there already, made with other options; "
                "--overwrite replaces it"
            )
        return [fmt for fmt in formats if again or fmt not in self.formats]

    def save(self) -> None:
        """Write it. Raises OutputError."""
        files = {name: size for sizes in self.formats.values() for name, size in sizes.items()}
        said = {**vars(self.result), "status": "ok", "formats": self.formats}
        write_record(self._path, self._key, said, files)

    def fill_in(self, entry: Result) -> None:
        """Add what was made to an entry of the report."""
        made = [name for files in self.formats.values() for name in files]
        entry.files += [f"{self._prefix}{name}" for name in made]
        entry.warnings += dict.fromkeys(self.result.warnings)
        if changed := [name for name in made if name in self._changed]:
            said = f"{', '.join(changed)}: changed since the batch wrote it, and left alone"
            entry.warnings.append(f"{said}; --again makes all anew")
        entry.character = self.result.character
        entry.seconds = round(entry.seconds + self.result.seconds, 3)
