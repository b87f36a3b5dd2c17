"""The page's pieces of HTML, made of what is known; texts from elsewhere are escaped."""

from __future__ import annotations

import base64
import io
import wave

import numpy as np

from unifeed_ros.console.drawing import as_text, small_drawing
from unifeed_ros.console.health import worst
from unifeed_ros.console.state import KIND_WORDS, HealthLine, LessonView, Phase, Taught, banner, steps

COLOURS = {"robot": "#00529c", "person": "#8a4b00", "nobody": "#3c4048", "stopped": "#b20018"}
SYMBOLS = {"robot": "\u25b6", "person": "\u25cf", "nobody": "\u25cb", "stopped": "\u25a0"}
"""A symbol beside every colour, as colour alone never says it; of those that fonts without emoji have too."""
HIGHEST_FORCE = 40.0
"""Force that fills the bar [N]."""
LEVELS = {0: ("#006b46", "&#10003;", "well"), 1: ("#7a5600", "!", "look"), 2: ("#b20018", "&#10007;", "broken")}
STYLE = """<style>
button { min-height: 40px !important; }
button span, button { font-size: 15px !important; font-weight: 600 !important; white-space: normal !important; }
label { color: #16181c !important; font-size: 14px !important; }
button:focus-visible { outline: 4px solid #000 !important; outline-offset: 2px; }
button[data-disabled], button:disabled { background: #e4e6ea !important; color: #5c6068 !important; }
</style>"""


def banner_html(view: LessonView) -> str:
    """Write the large lines: who has control, what happens, what is asked, force at the hand."""
    lines = banner(view)
    share = min(view.force / HIGHEST_FORCE, 1.0)
    progress = ""
    if view.phase is Phase.LEARNING:
        progress = _bar(view.progress, "#00529c", f"learning: {100 * view.progress:.0f} %")
    sick = worst(view.health)
    warning = "" if sick is None or view.phase is Phase.WAITING else (
        f'<div style="background:#fff3d6;color:#4a3500;padding:4px 10px;font-size:14px">&#9888; '
        f"{as_text(sick.name)}: {as_text(sick.text)}. {as_text(sick.remedy)}</div>")
    return f"""{STYLE}<div role="status" aria-live="polite" style="font-family:sans-serif">
<div id="who" style="background:{COLOURS[lines.kind]};color:#fff;padding:8px 12px;font-size:22px;font-weight:700">
{SYMBOLS[lines.kind]} {as_text(lines.who)}</div>
<div style="padding:6px 12px;color:#16181c"><div id="stage" style="font-size:16px;font-weight:600">
{as_text(lines.stage)}</div>
<div id="request" style="font-size:18px;line-height:1.3;min-height:48px">{as_text(lines.request)}</div>
{_bar(share, "#8a4b00", f"force at the hand: {view.force:.0f} N")}{progress}</div>{warning}</div>"""


def steps_html(view: LessonView) -> str:
    """Write the steps of a first lesson, the present one large."""
    current = next((k for k, step in enumerate(steps(view)) if not step.done), None)
    rows = []
    for k, step in enumerate(steps(view)):
        mark = "&#9745;" if step.done else "&#9744;"
        weight = "700" if k == current else "400"
        rows.append(f'<div style="font-weight:{weight};font-size:16px;padding:2px 0">{mark} {k + 1}. '
                    f"{as_text(step.title)}</div>")
        if k == current:
            rows.append(f'<div style="padding:0 0 4px 24px;font-size:15px">{as_text(step.text)}</div>')
    return f'<div style="padding:2px 12px;color:#16181c;font-family:sans-serif">{"".join(rows)}</div>'


def taught_html(number: int, item: Taught) -> str:
    """Write one line of the list of what was taught."""
    dim = "opacity:0.55;text-decoration:line-through" if item.taken_back else ""
    trust = "" if item.taken_back else _bar(item.reliability, "#006b46", f"trusted: {100 * item.reliability:.0f} %")
    change = as_text(item.change) if item.change and not item.taken_back else ""
    return (f'<div style="display:flex;gap:8px;padding:4px 12px;color:#16181c;font-family:sans-serif;{dim}">'
            f"<div>{small_drawing(item.paths)}</div><div style=\"flex:1;font-size:14px\">"
            f"<b>{number}. {KIND_WORDS.get(item.kind, 'Something')}</b><br>{change}{trust}</div></div>")


def question_html(view: LessonView) -> str:
    """Write why a question is asked."""
    if view.question is None:
        return ""
    told = "" if "bit" in view.question.reason else f" Expected information: {view.question.information:.2f} bit."
    return ('<div style="padding:4px 12px;color:#16181c;font-family:sans-serif;font-size:15px">'
            f"<b>Which motion is better?</b><br>Why it is asked: {as_text(view.question.reason)}.{told}</div>")


def health_html(lines: tuple[HealthLine, ...]) -> str:
    """Write one line a part, broken ones first."""
    rows = []
    for line in sorted(lines, key=lambda one: -one.level):
        colour, mark, word = LEVELS[line.level]
        remedy = f"<br><i>{as_text(line.remedy)}</i>" if line.remedy else ""
        rows.append(f'<div style="padding:3px 12px;font-size:14px"><b style="color:{colour}">{mark} '
                    f"{as_text(line.name)}</b> ({word}): {as_text(line.text)}{remedy}</div>")
    return f'<div style="color:#16181c;font-family:sans-serif">{"".join(rows)}</div>'


def notes_html(view: LessonView) -> str:
    """Write the newest answers of the services, and the regret where the true reward is known."""
    rows = [f'<div style="font-size:14px;padding:1px 12px">{as_text(note)}</div>' for note in view.notes[-4:]]
    if view.regret:
        worth = ", ".join(f"{value:.2f}" for value in view.regret)
        rows.append(f'<div style="font-size:14px;padding:1px 12px">normalised regret after each interaction '
                    f"(0: perfect, 1: nothing learned): <b>{worth}</b></div>")
    return f'<div style="color:#16181c;font-family:sans-serif">{"".join(rows)}</div>'


def sound_html(frequencies: tuple[float, ...], number: int) -> str:
    """Give a short sound of tones one after the other [Hz]; the number makes it play anew."""
    if not frequencies:
        return ""
    data = base64.b64encode(_tones(frequencies)).decode()
    return f'<audio autoplay data-number="{number}" src="data:audio/wav;base64,{data}"></audio>'


def _tones(frequencies: tuple[float, ...], rate: int = 8000, duration: float = 0.12) -> bytes:
    time = np.arange(int(rate * duration)) / rate
    fade = np.minimum(1.0, np.minimum(time, duration - time) / 0.02)
    samples = np.concatenate([0.3 * fade * np.sin(2 * np.pi * f * time) for f in frequencies])
    file = io.BytesIO()
    with wave.open(file, "wb") as sound:
        sound.setnchannels(1)
        sound.setsampwidth(2)
        sound.setframerate(rate)
        sound.writeframes((samples * 32767).astype("<i2").tobytes())
    return file.getvalue()


def _bar(share: float, colour: str, words: str) -> str:
    return (f'<div style="font-size:13px">{as_text(words)}</div><div style="background:#d9dce1;height:8px;'
            f'border-radius:4px"><div style="width:{100 * min(max(share, 0.0), 1.0):.0f}%;height:8px;'
            f'border-radius:4px;background:{colour}"></div></div>')
