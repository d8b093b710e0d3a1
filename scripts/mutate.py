#!/usr/bin/env python3
"""How many random mistakes in the product the tests notice.

    python -m pytest -n 2 --cov=handfit_core --cov-context=test tests/core      which tests reach which line
    python -m coverage json --show-contexts -o out/core.json
    python scripts/mutate.py out/core.json -o out/mutants.json

Changes one thing at a time (a comparison, a sign, a constant, a condition, what is returned) in a copy of the
repository, and runs those tests that reach the line, with the Python that runs here, until one fails; those
first that reach the least. The same seed changes the same lines of the same code. `--again` makes the changes
of an earlier OUT, where their lines are still there. pytest-cov must be installed.
"""

from __future__ import annotations

import argparse
import ast
import json
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PRODUCT = ("handfit_core/", "blender_manient/")
SWAPS = {
    **{ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">", ast.Eq: "!=", ast.NotEq: "=="},
    **{ast.Is: "is not", ast.IsNot: "is", ast.In: "not in", ast.NotIn: "in", ast.And: "or", ast.Or: "and"},
    **{ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*", ast.FloorDiv: "*", ast.Mod: "*"},
}
MOST_TESTS = 25
"""Tests of one change at most"""
PATIENCE_S = 300
"""Seconds; tests that take longer have noticed nothing"""


@dataclass(frozen=True)
class Change:
    """Another text between two columns of a line, and the test that has noticed it; empty: none."""

    file: str
    line: int
    start: int
    end: int
    before: str
    """The whole line"""
    new: str
    noticed: str = ""

    @property
    def key(self) -> tuple[str, str, int, str]:
        """What is left of it in other code, where files and lines move."""
        return Path(self.file).name, self.before, self.start, self.new

    @property
    def after(self) -> str:
        """The whole line with the change."""
        return self.before[: self.start] + self.new + self.before[self.end :]


def changes(file: str, text: str) -> list[Change]:
    """Every change of a file that is on one line."""
    found, lines = [], text.splitlines()

    def change(node: ast.expr, new: str) -> None:
        before, end = lines[node.lineno - 1], node.end_col_offset or 0
        # Before Python 3.12 what stands in an f-string has no true place.
        if node.lineno == node.end_lineno and _is(before[node.col_offset : end], node):
            found.append(Change(file, node.lineno, node.col_offset, end, before, new))

    for node in ast.walk(ast.parse(text)):
        match node:
            case ast.Compare(left, [operator], [right]) | ast.BinOp(left, operator, right) if type(
                operator
            ) in SWAPS and not _has_text(node):
                change(node, f"({ast.unparse(left)}) {SWAPS[type(operator)]} ({ast.unparse(right)})")
            case ast.BoolOp(operator, values):
                change(node, f" {SWAPS[type(operator)]} ".join(f"({ast.unparse(value)})" for value in values))
            case ast.Constant(bool() as value):
                change(node, str(not value))
            case ast.Constant(int() | float() as value):
                change(node, repr(value + 1 if isinstance(value, int) else 2.0 * value + 0.5))
            case ast.If(test) | ast.While(test):
                change(test, f"not ({ast.unparse(test)})")
            case ast.Return(ast.expr() as value):
                change(value, "None")
    return found


def _has_text(node: ast.expr) -> bool:
    """Whether a sum is one of texts, which has no other operator."""
    inner = ast.walk(node) if isinstance(node, ast.BinOp) else ()
    return any(isinstance(each, ast.Constant) and isinstance(each.value, str) for each in inner)


def _is(text: str, node: ast.expr) -> bool:
    try:
        return ast.dump(ast.parse(text, mode="eval").body) == ast.dump(node)
    except SyntaxError:
        return False


def noticed(copy: Path, tests: Sequence[str]) -> str:
    """The first of these tests that fails in that copy of the repository."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
    try:
        done = subprocess.run(
            command, cwd=copy, capture_output=True, text=True, timeout=PATIENCE_S, check=False
        )
    except subprocess.TimeoutExpired:
        return ""
    failed = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return (failed or [f"pytest ended with {done.returncode}"])[0] if done.returncode else ""


def main() -> int:
    """Run the script; returns the exit code."""
    parser = argparse.ArgumentParser(description="How many random mistakes the tests notice.")
    parser.add_argument("reached", type=Path, help="which tests reach which line, as coverage tells it")
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--again", type=Path, metavar="OUT", help="the changes of an earlier output")
    parser.add_argument("--only", default="", metavar="FOLDER", help="of the chosen changes those in it")
    args = parser.parse_args()
    told = json.loads(args.reached.read_text())["files"]
    reached = {
        (file, int(line)): {re.split(r"[|[]", test)[0] for test in tests if test}
        for file, of_file in told.items()
        for line, tests in of_file["contexts"].items()
    }
    reach = Counter(test for tests in reached.values() for test in tests)
    listed = subprocess.check_output(["git", "ls-files"], cwd=ROOT, text=True).splitlines()
    files = [file for file in listed if (ROOT / file).is_file()]
    product = [file for file in files if file.startswith(PRODUCT) and file.endswith(".py")]
    chosen = [change for file in product for change in changes(file, (ROOT / file).read_text())]
    if args.again is None:
        chosen = random.Random(args.seed).sample(chosen, args.count)
    else:
        wanted = {Change(**{**each, "noticed": ""}).key for each in json.loads(args.again.read_text())}
        chosen = [each for each in chosen if each.key in wanted]
    made = []
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder, "copy")
        for file in files:
            (copy / file).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / file, copy / file)
        if (shared := ROOT.parent / "shared").is_dir():
            Path(folder, "shared").symlink_to(shared)
        for each in (each for each in chosen if each.file.startswith(args.only)):
            lines = (ROOT / each.file).read_text().splitlines(keepends=True)
            tests = sorted(reached.get((each.file, each.line), ()), key=lambda test: (reach[test], test))
            lines[each.line - 1] = f"{each.after}\n"
            (copy / each.file).write_text("".join(lines))
            by = noticed(copy, tests[:MOST_TESTS]) if tests else ""
            shutil.copy2(ROOT / each.file, copy / each.file)
            made.append({**asdict(each), "noticed": by})
            args.output.write_text(json.dumps(made, indent=1))
            print(f"{len(made)} {each.file}:{each.line} {each.new}: {by or 'NOT NOTICED'}", flush=True)
    print(f"noticed {sum(bool(each['noticed']) for each in made)} of {len(made)}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
