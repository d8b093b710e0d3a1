"""Damaging bytes, by kind: each is a file that a bad disk, a bad copy or a bad person makes of a good one."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from random import Random
from typing import Any

from tests.hostile.engine import Case, file_case

EXTREMES = (0, 1, *((1 << bits) - 1 for bits in (7, 8, 15, 16, 31, 32, 63, 64)), 0x80, 0x80000000)


def flip(data: bytearray, rng: Random) -> None:
    for _ in range(rng.choice((1, 1, 4, 64))):
        data[_place(data, rng)] ^= 1 << rng.randrange(8)


def cut(data: bytearray, rng: Random) -> None:
    del data[rng.choice((_place(data, rng), len(data) - rng.randrange(1, 9))) :]


def splice(data: bytearray, rng: Random) -> None:
    start, size = _place(data, rng), rng.randrange(1, 2000)
    at = _place(data, rng)
    data[at : at + size] = data[start : start + size]


def insert(data: bytearray, rng: Random) -> None:
    start, size = _place(data, rng), rng.randrange(1, 300)
    at = _place(data, rng)
    data[at:at] = data[start : start + size] * rng.choice((1, 2, 50))


def drop(data: bytearray, rng: Random) -> None:
    at = _place(data, rng)
    del data[at : at + rng.randrange(1, 200)]


def extreme(data: bytearray, rng: Random) -> None:
    for _ in range(rng.choice((1, 1, 3))):
        size, at = rng.choice((1, 2, 4, 4, 4, 8)), _place(data, rng)
        value = rng.choice(EXTREMES) & ((1 << 8 * size) - 1)
        data[at : at + size] = value.to_bytes(size, rng.choice(("little", "big")))


def noise(data: bytearray, rng: Random) -> None:
    at, size = _place(data, rng), rng.choice((1, 8, 400))
    data[at : at + size] = rng.randbytes(size)


def _place(data: bytearray, rng: Random) -> int:
    """Half of them near the beginning, where headers are."""
    return rng.randrange(min(len(data), rng.choice((200, len(data)))))


MUTATIONS = (flip, cut, splice, insert, drop, extreme, noise)


def mutated(data: bytes, mutation: Callable[[bytearray, Random], None], rng: Random) -> bytes:
    changed = bytearray(data)
    mutation(changed, rng)
    return bytes(changed)


def mutants(
    stem: str, door: str, good: Callable[[], bytes], file: str, count: int, **arguments: Any
) -> Iterator[Case]:
    """Cases for one good file: `count` of each mutation. The door gets its path and `arguments`."""
    for mutation in MUTATIONS:
        made = lambda place, mutation=mutation: mutated(good(), mutation, place.rng)  # noqa: E731
        for number in range(count):
            yield file_case(f"{stem}-{mutation.__name__}-{number}", door, file, made, **arguments)


def json_with(content: Any, path: tuple[str | int, ...], text: str) -> str:
    """`content` as JSON, with that text where `path` leads."""
    content = inner = json.loads(json.dumps(content))
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = "@@"
    return json.dumps(content).replace('"@@"', text)


def system_call() -> bytes:
    """A pickle that runs something, whose trace is a file."""
    return b"cos\nsystem\n(Vtouch canary\ntR."
