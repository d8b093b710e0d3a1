"""overview.html: all inputs of a batch on one page, those first that somebody should look at.

One file that needs nothing from elsewhere: it is opened from the output folder, and contact sheets are loaded
as they come into view.
"""

from __future__ import annotations

import html
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, Final
from urllib.parse import quote

from handfit_core.files import storable, written_whole
from handfit_core.fit_quality import IN_PICTURE, NOT_KNOWN, Scale, expected_scale
from handfit_core.sheet import SUFFIX

_SEEN: Final = 0.8
"""Share of a clip's frames in which a hand was found, below which the clip is doubtful"""
_DOUBTED: Final = 0.2
"""Share of a hand's frames that are doubtful, above which the clip is, too"""
_SHOWN: Final = 3
"""Warnings and attempts that are seen without a click"""

Entry = Mapping[str, Any]
"""One of report.json's inputs, as docs/batch.md describes them"""

_SECTIONS: Final = {
    "failed": ("Failed", "These are not done. What went wrong, and in which attempts:"),
    "doubtful": ("Doubtful", "Look at these first: the worst one is on top."),
    "unknown": (
        "Not known",
        "Nobody can tell how far these are off: likely errors were not measured for their keypoints.",
    ),
    "good": ("Good", "Nothing speaks against these."),
    "pending": ("Waiting", ""),
}
"""Section -> its title and what stands below, in the order of the page"""
_DONE: Final = ("doubtful", "unknown", "good")
"""Those of what a task has made"""

_STYLE: Final = """
:root{color-scheme:light dark;--ground:#f6f6f4;--card:#fff;--text:#1d1f21;--faint:#62666b;--line:#dcdcd8;
--failed:#b3261e;--doubtful:#9a5b00;--good:#2c6e35;--pending:#62666b}
@media (prefers-color-scheme:dark){:root{--ground:#17181a;--card:#212326;--text:#e6e6e3;--faint:#a2a6ab;
--line:#383b3f;--failed:#ff8a80;--doubtful:#f0b35a;--good:#86cf90;--pending:#a2a6ab}}
*{box-sizing:border-box}
body{margin:0 auto;padding:1rem;max-width:96rem;background:var(--ground);color:var(--text);
font:15px/1.45 system-ui,sans-serif;overflow-wrap:anywhere}
h1{font-size:1.5rem;margin:.2rem 0}h2{font-size:1.15rem;margin:2rem 0 .2rem}h3{font-size:1rem;margin:0}
p,ul,ol{margin:.3rem 0}ul,ol{padding-left:1.2rem}a{color:inherit}
small,.faint{color:var(--faint);font-size:.87rem}
nav{display:flex;flex-wrap:wrap;gap:.5rem;margin:.8rem 0}
nav a{padding:.25rem .8rem;border:1px solid;border-radius:1rem;text-decoration:none;font-weight:600}
input{width:min(100%,30rem);padding:.45rem .7rem;font:inherit;color:inherit;background:var(--card);
border:1px solid var(--line);border-radius:.4rem}
article{background:var(--card);border:1px solid var(--line);border-left:4px solid var(--pending);
border-radius:.4rem;padding:.6rem .8rem;margin:.5rem 0;
content-visibility:auto;contain-intrinsic-size:auto 11rem}
article.sheet{display:grid;grid-template-columns:minmax(15rem,27%) 1fr;gap:1rem;
contain-intrinsic-size:auto 12rem}
article.line{padding:.15rem .8rem;margin:.15rem 0;contain-intrinsic-size:auto 1.7rem}
article.line h3{display:inline;font-weight:400;margin-right:.6rem}
img{display:block;height:11rem;max-width:100%;object-fit:contain;object-position:left top}
.files a{margin-right:.7rem}[hidden]{display:none!important}
.failed{color:var(--failed)}.doubtful,.poor,.fair{color:var(--doubtful)}.good{color:var(--good)}
.pending,.unknown{color:var(--pending)}
article.failed,article.doubtful,article.unknown,article.good,article.pending{color:inherit}
article.failed{border-left-color:var(--failed)}article.doubtful{border-left-color:var(--doubtful)}
article.good{border-left-color:var(--good)}
@media (max-width:45rem){article.sheet{grid-template-columns:1fr;gap:.5rem;contain-intrinsic-size:auto 20rem}
.strip{overflow-x:auto}img{height:9rem;max-width:none}}
"""

_SCRIPT: Final = """
const field=document.querySelector("input");field.hidden=false;
field.addEventListener("input",()=>{const wanted=field.value.toLowerCase();
for(const section of document.querySelectorAll("section")){let some=false;
for(const one of section.querySelectorAll("article"))
some=!(one.hidden=!one.textContent.toLowerCase().includes(wanted))||some;
section.hidden=!some}});
"""


def write_overview(
    path: str | os.PathLike[str], title: str, entries: Sequence[Entry], *, at: datetime | None = None
) -> None:
    """Write the overview of a batch's entries, whole or not at all.

    It belongs into the output folder: links are relative to its own. `at` is when things stood as the entries
    say; now, where it is missing. Raises OutputError.
    """
    with written_whole(path) as beside:
        beside.write_text("".join(_page(title, entries, at)), encoding="utf-8")


def section_of(entry: Entry) -> str:
    """Where an entry stands on the page: one of `_SECTIONS`."""
    status = entry.get("status")
    if status == "ok":
        hands, frames = _hands(entry), _number(entry, "frames")
        doubted = not hands or _list(entry, "warnings") or any(_hand(hand, frames)[1] for hand in hands)
        unknown = any(hand.get("error_known") is False for hand in hands)
        return "doubtful" if doubted else "unknown" if unknown else "good"
    return "failed" if status == "failed" else "pending"


def _page(title: str, entries: Sequence[Entry], at: datetime | None) -> Iterator[str]:
    sections: dict[str, list[Entry]] = {name: [] for name in _SECTIONS}
    for entry in entries:
        sections[section_of(entry)].append(entry)
    when = (at or datetime.now(UTC)).astimezone(UTC)
    yield (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{_text(title)}: captured hands</title><style>{_STYLE}</style></head>\n<body><header>"
        f"<h1>{_name(title)}</h1><p class=faint>As of {when:%Y-%m-%d %H:%M} UTC; "
        '<a href="report.json">report.json</a> holds the same for programs.</p>\n'
    )
    yield from _summary(sections)
    yield '<input type="search" hidden placeholder="Show what has this in its name, messages or hosts">'
    yield "</header>\n<main>\n"
    for name, found in sections.items():
        if found:
            heading, below = _SECTIONS[name]
            yield f"<section id={name}><h2 class={name}>{heading} ({_count(len(found))})</h2>"
            yield f"<p class=faint>{below}</p>\n"
            yield from (_card(name, entry) for entry in sorted(found, key=_badness, reverse=True))
            yield "</section>\n"
    yield f"</main><script>{_SCRIPT}</script></body></html>\n"


def _summary(sections: Mapping[str, Sequence[Entry]]) -> Iterator[str]:
    """What there is of each kind, what it took, and what is left."""
    links = (
        f'<a class={name} href="#{name}">{_count(len(found))} {_SECTIONS[name][0].lower()}</a>'
        for name, found in sections.items()
        if found
    )
    yield f"<nav>{''.join(links) or 'There is nothing in this batch.'}</nav>"
    done = [entry for name in _DONE for entry in sections[name]]
    frames, seconds = (sum(_number(entry, key) for entry in done) for key in ("frames", "seconds"))
    if seconds:
        yield f"<p>{_count(frames)} frames in {_duration(seconds)}, {frames / seconds:.1f} a second.</p>"
    if left := len(sections["pending"]):
        work = (
            f", about {_duration(left * seconds / len(done))} of work by the mean so far" if seconds else ""
        )
        yield f"<p>{_count(left)} left{work}.</p>"
    yield "\n"


def _card(section: str, entry: Entry) -> str:
    """One entry as an article: what it is, what came out of it, and why it is where it is."""
    files = [file for file in _list(entry, "files") if isinstance(file, str)]
    sheets = [file for file in files if file.endswith(SUFFIX)]
    name, given = _said(entry, "name"), _said(entry, "input")
    facts = [_text(_host(entry))] if _host(entry) else []
    if section in (*_DONE, "failed"):
        facts.insert(0, _duration(_number(entry, "seconds")))
    if section in _DONE:
        frames = _number(entry, "frames")
        facts.insert(0, f"{_count(frames)} frames" if frames != 1 else "1 frame")
    parts = [f"<h3>{_name(name)}</h3>"]
    if section == "pending":
        parts.append(f"<small>{_name(given)}</small>")
        return f'<article class="{section} line">{"".join(parts)}</article>\n'
    parts.append(f"<small>{_name(given)}</small><p class=faint>{' · '.join(facts)}</p>")
    if section == "failed":
        parts.append(f"<p class=failed>{_text(_said(entry, 'error'))}</p>")
    attempts = [_attempt(n, a) for n, a in enumerate(_list(entry, "attempts"), 1)]
    parts.append(_listed(attempts) if len(attempts) > (section == "failed") else "")
    hands = [_hand(hand, _number(entry, "frames")) for hand in _hands(entry)]
    parts.append(_listed([f"<span class=doubtful>{h}</span>" if bad else h for h, bad in hands], len(hands)))
    if section == "doubtful":
        warnings = [_text(str(warning)) for warning in _list(entry, "warnings")]
        parts.append(_listed(warnings if hands else ["No hand was captured.", *warnings]))
    links = (
        f'<a href="{_link(file)}">{_text(_label(file, name))}</a>' for file in files if file not in sheets
    )
    parts.append(f"<p class=files>{''.join(links)}</p>" if files else "")
    strips = "".join(
        f'<div class=strip><a href="{_link(file)}"><img loading="lazy" src="{_link(file)}" '
        f'alt="Frames of {_text(name)} with the captured hands over them"></a></div>'
        for file in sheets[:1]
    )
    kind = f"{section} sheet" if strips else section
    return f'<article class="{kind}"><div>{"".join(parts)}</div>{strips}</article>\n'


def _hand(hand: Entry, frames: float) -> tuple[str, bool]:
    """A hand in words, and whether somebody should look at it."""
    detected, doubtful, said = _number(hand, "detected"), _number(hand, "doubtful"), ""
    scale, error = _error(hand)
    quality = scale.quality(error) if scale else "good"
    if frames > 1:
        said = f" in {_count(detected)} of {_count(frames)} frames"
        said += f", {_count(doubtful)} of them doubtful" if doubtful else ""
    if hand.get("error_known") is False:
        said += f", {NOT_KNOWN}"
    elif scale is not None:
        said += f", {scale.title.lower()} {scale.said(error)} (<span class={quality}>{quality}</span>)"
    doubted = quality == "poor" or detected < _SEEN * frames or doubtful > _DOUBTED * detected
    return f"{_text(_said(hand, 'side'))} hand{said}", doubted


def _attempt(number: int, attempt: object) -> str:
    """A failed attempt: where, after how long, and what it ended in."""
    if not isinstance(attempt, Mapping):
        return _text(str(attempt))
    where = f"on {_text(host)} " if (host := _said(attempt, "host")) else ""
    after = _duration(_number(attempt, "seconds"))
    return f"attempt {number} {where}failed after {after}: {_text(_said(attempt, 'error'))}"


def _hands(entry: Entry) -> list[Entry]:
    return [hand for hand in _list(entry, "hands") if isinstance(hand, Mapping)]


def _badness(entry: Entry) -> tuple[float, int]:
    """The more, the higher on the page: how wrong the worst hand is likely to be, by the limit of poor ones,
    and how much of the clip is missing or doubtful; then how many warnings there are."""
    frames, worst = max(1.0, _number(entry, "frames")), 0.0
    for hand in _hands(entry):
        scale, error = _error(hand)
        missing = 1.0 - _number(hand, "detected") / frames + _number(hand, "doubtful") / frames
        worst = max(worst, missing + (error / scale.fair_below if scale else 0.0))
    return worst, len(_list(entry, "warnings"))


def _error(hand: Entry) -> tuple[Scale | None, float]:
    """How far off a hand is likely to be, or lies from the picture where nobody looked; and in what."""
    if hand.get("error_known") is False:
        return None, 0.0
    likely = expected_scale(_number(hand, "detected"))
    for scale, key in ((likely, "mean_expected_error"), (IN_PICTURE, "mean_error_of_hand")):
        if isinstance(hand.get(key), int | float):
            return scale, _number(hand, key)
    return None, 0.0


def _host(entry: Entry) -> str:
    """Where it was done, or tried last."""
    tried = [attempt for attempt in _list(entry, "attempts") if isinstance(attempt, Mapping)]
    return _said(entry, "host") or (_said(tried[-1], "host") if tried else "")


def _listed(items: Sequence[str], shown: int = _SHOWN) -> str:
    """A list, of which the rest opens with a click."""
    first, rest = "".join(f"<li>{i}" for i in items[:shown]), "".join(f"<li>{i}" for i in items[shown:])
    more = f"<details><summary>{_count(len(items) - shown)} more</summary><ul>{rest}</ul></details>"
    return f"<ul>{first}</ul>{more if rest else ''}" if items else ""


def _label(file: str, name: str) -> str:
    """A file's name without that of the entry, which stands above."""
    last = file.rpartition("/")[2]
    return last.removeprefix(name).lstrip("._-") or last


def _link(file: str) -> str:
    """A path relative to the page as an address: whatever it is called, it leads into the page's folder or
    below."""
    try:
        data = file.encode("utf-8", "surrogateescape")  # the very bytes of a name on Linux
    except UnicodeEncodeError:
        data = storable(file).encode()
    return f"./{quote(data)}"


def _text(text: str) -> str:
    """A text for the page: on one line, and without what would end an attribute or begin a tag."""
    return html.escape(re.sub(r"[\x00-\x1f\x7f-\x9f\ud800-\udfff]+", "\ufffd", " ".join(text.split())))


def _name(text: str) -> str:
    """A name of any alphabet, which does not turn around what stands beside it."""
    return f"<bdi>{_text(text)}</bdi>"


def _said(entry: Entry, key: str) -> str:
    value = entry.get(key)
    return value if isinstance(value, str) else ""


def _list(entry: Entry, key: str) -> Sequence[Any]:
    value = entry.get(key)
    return value if isinstance(value, list | tuple) else ()


def _number(entry: Entry, key: str) -> float:
    value = entry.get(key)
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else 0.0


def _count(number: float) -> str:
    return f"{number:,.0f}".replace(",", "\u202f")


def _duration(seconds: float) -> str:
    if seconds < 60.0:
        return f"{seconds:.1f} s" if seconds < 9.95 else f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 60 else f"{_count(minutes // 60)} h {minutes % 60:02d} min"
