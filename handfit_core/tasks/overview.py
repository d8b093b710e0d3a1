"""overview.html: all inputs of a batch on one page, those first that somebody should look at.

One file that needs nothing from elsewhere: it is opened from the output folder, and contact sheets are loaded
as they come into view.
"""

from __future__ import annotations

import html
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from typing import Final
from urllib.parse import quote

from handfit_core.common.files import storable, written_whole
from handfit_core.take.fit_quality import IN_PICTURE, NOT_KNOWN, Scale, expected_scale
from handfit_core.take.sheet import SUFFIX
from handfit_core.tasks.record import Attempt, Hand, Result

_SEEN: Final = 0.8
"""Share of a clip's frames in which a hand was found, below which the clip is doubtful"""
_DOUBTED: Final = 0.2
"""Share of a hand's frames that are doubtful above which the clip is doubtful, too"""
_SHOWN: Final = 3
"""How many warnings and attempts are seen without a click"""

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
"""For each section its title and the text below, in the order of the page"""
_DONE: Final = ("doubtful", "unknown", "good")
"""The sections of inputs of which a take was made"""

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
    path: str | os.PathLike[str], title: str, results: Sequence[Result], *, at: datetime | None = None
) -> None:
    """Write the overview of a batch's results, whole or not at all.

    It belongs into the output folder: links are relative to its own. `at` is when things stood as the results
    say; now, where it is missing. Raises OutputError.
    """
    with written_whole(path) as beside:
        beside.write_text("".join(_page(title, results, at)), encoding="utf-8")


def scale_and_error(hand: Hand) -> tuple[Scale | None, float]:
    """Return how far off a hand of a result is likely to be, or lies from the picture where nobody looked,
    and the scale by which that number is measured."""
    likely = expected_scale(hand.detected)
    for scale, error in ((likely, hand.mean_expected_error), (IN_PICTURE, hand.mean_error_of_hand)):
        if hand.error_known and error is not None:
            return scale, error
    return None, 0.0


def _section_of(result: Result) -> str:
    """Return where a result stands on the page: one of `_SECTIONS`."""
    if result.status == "ok":
        doubted = not result.hands or result.warnings or any(_hand(h, result.frames)[1] for h in result.hands)
        unknown = not all(hand.error_known for hand in result.hands)
        return "doubtful" if doubted else "unknown" if unknown else "good"
    return "failed" if result.status == "failed" else "pending"


def _page(title: str, results: Sequence[Result], at: datetime | None) -> Iterator[str]:
    sections: dict[str, list[Result]] = {name: [] for name in _SECTIONS}
    for result in results:
        sections[_section_of(result)].append(result)
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
            yield from (_card(name, result) for result in sorted(found, key=_badness, reverse=True))
            yield "</section>\n"
    yield f"</main><script>{_SCRIPT}</script></body></html>\n"


def _summary(sections: Mapping[str, Sequence[Result]]) -> Iterator[str]:
    """Yield the page's summary: how many inputs there are of each kind, how long they took, and what is
    left."""
    links = (
        f'<a class={name} href="#{name}">{_count(len(found))} {_SECTIONS[name][0].lower()}</a>'
        for name, found in sections.items()
        if found
    )
    yield f"<nav>{''.join(links) or 'There is nothing in this batch.'}</nav>"
    done = [result for name in _DONE for result in sections[name]]
    frames, seconds = sum(result.frames for result in done), sum(result.seconds for result in done)
    if seconds:
        yield f"<p>{_count(frames)} frames in {_duration(seconds)}, {frames / seconds:.1f} a second.</p>"
    if left := len(sections["pending"]):
        each = (
            f", about {_duration(left * seconds / len(done))} of work by the mean so far" if seconds else ""
        )
        yield f"<p>{_count(left)} left{each}.</p>"
    yield "\n"


def _card(section: str, result: Result) -> str:
    """Return one result as an article of HTML: what it is, what came out of it, and why it is where it is."""
    name, given = _name(result.name), _name(result.input)
    if section == "pending":
        return f'<article class="{section} line"><h3>{name}</h3><small>{given}</small></article>\n'
    host = result.host or (result.attempts[-1].host if result.attempts else "")
    facts = [_duration(result.seconds), *([_text(host)] if host else [])]
    if section != "failed":
        facts.insert(0, "1 frame" if result.frames == 1 else f"{_count(result.frames)} frames")
    parts = [f"<h3>{name}</h3><small>{given}</small><p class=faint>{' · '.join(facts)}</p>"]
    if section == "failed":
        parts.append(f"<p class=failed>{_text(result.error)}</p>")
    if len(result.attempts) > (section == "failed"):
        parts.append(_listed([_attempt(n, a) for n, a in enumerate(result.attempts, 1)]))
    hands = [_hand(hand, result.frames) for hand in result.hands]
    parts.append(_listed([f"<span class=doubtful>{h}</span>" if bad else h for h, bad in hands], len(hands)))
    if section == "doubtful":
        warnings = [_text(warning) for warning in result.warnings]
        parts.append(_listed(warnings if hands else ["No hand was captured.", *warnings]))
    sheets = [file for file in result.files if file.endswith(SUFFIX)]
    links = (
        f'<a href="{_link(file)}">{_text(_label(file, result.name))}</a>'
        for file in result.files
        if file not in sheets
    )
    parts.append(f"<p class=files>{''.join(links)}</p>" if result.files else "")
    strips = "".join(
        f'<div class=strip><a href="{_link(file)}"><img loading="lazy" src="{_link(file)}" '
        f'alt="Frames of {_text(result.name)} with the captured hands over them"></a></div>'
        for file in sheets[:1]
    )
    kind = f"{section} sheet" if strips else section
    return f'<article class="{kind}"><div>{"".join(parts)}</div>{strips}</article>\n'


def _hand(hand: Hand, frames: float) -> tuple[str, bool]:
    """Return a hand in words, and True if somebody should look at it."""
    detected, doubtful, said = hand.detected, hand.doubtful or 0, ""
    scale, error = scale_and_error(hand)
    quality = scale.quality(error) if scale else "good"
    if frames > 1:
        said = f" in {_count(detected)} of {_count(frames)} frames"
        said += f", {_count(doubtful)} of them doubtful" if doubtful else ""
    if not hand.error_known:
        said += f", {NOT_KNOWN}"
    elif scale is not None:
        said += f", {scale.title.lower()} {scale.said(error)} (<span class={quality}>{quality}</span>)"
    doubted = quality == "poor" or detected < _SEEN * frames or doubtful > _DOUBTED * detected
    return f"{_text(hand.side)} hand{said}", doubted


def _attempt(number: int, attempt: Attempt) -> str:
    """Return a failed attempt in words: where, after how long, and what it ended in."""
    where, after = _text(attempt.host), _duration(attempt.seconds)
    return f"attempt {number} on {where} failed after {after}: {_text(attempt.error)}"


def _badness(result: Result) -> tuple[float, int]:
    """Return a key for sorting, the larger the higher on the page: how wrong the worst hand is likely to be,
    by the limit of poor ones, and how much of the clip is missing or doubtful; then how many warnings there
    are."""
    frames, worst = max(1.0, result.frames), 0.0
    for hand in result.hands:
        scale, error = scale_and_error(hand)
        missing = 1.0 - hand.detected / frames + (hand.doubtful or 0) / frames
        worst = max(worst, missing + (error / scale.fair_below if scale else 0.0))
    return worst, len(result.warnings)


def _listed(items: Sequence[str], shown: int = _SHOWN) -> str:
    """Return a list in HTML, whose rest opens with a click."""
    first, rest = "".join(f"<li>{i}" for i in items[:shown]), "".join(f"<li>{i}" for i in items[shown:])
    more = f"<details><summary>{_count(len(items) - shown)} more</summary><ul>{rest}</ul></details>"
    return f"<ul>{first}</ul>{more if rest else ''}" if items else ""


def _label(file: str, name: str) -> str:
    """Return a file's name without that of the entry, which stands above."""
    last = file.rpartition("/")[2]
    return last.removeprefix(name).lstrip("._-") or last


def _link(file: str) -> str:
    """Return a path relative to the page as an address: whatever it is called, it leads into the page's
    folder or below."""
    try:
        data = file.encode("utf-8", "surrogateescape")  # the very bytes of a name on Linux
    except UnicodeEncodeError:
        data = storable(file).encode()
    return f"./{quote(data)}"


def _text(text: str) -> str:
    """Return a text for the page: on one line, and without what would end an attribute or begin a tag."""
    return html.escape(re.sub(r"[\x00-\x1f\x7f-\x9f\ud800-\udfff]+", "\ufffd", " ".join(text.split())))


def _name(text: str) -> str:
    """Return a name of any alphabet, marked so that it does not turn around the text beside it."""
    return f"<bdi>{_text(text)}</bdi>"


def _count(number: float) -> str:
    return f"{number:,.0f}".replace(",", "\u202f")


def _duration(seconds: float) -> str:
    if seconds < 60.0:
        return f"{seconds:.1f} s" if seconds < 9.95 else f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 60 else f"{_count(minutes // 60)} h {minutes % 60:02d} min"
