"""The report as one HTML page that needs nothing else: no script, no font, no file beside it."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from typing import NamedTuple

from bicycle_env.report.quantities import Group, Quantity
from bicycle_env.report.words import in_words

STYLE = """
:root { color-scheme: light dark; --text: #1b1b1b; --back: #ffffff; --soft: #f2f4f6; --line: #c9ced3; --link: #0b5a94; }
@media (prefers-color-scheme: dark) {
  :root { --text: #e6e6e6; --back: #16181b; --soft: #22262b; --line: #444b53; --link: #7cc0f0; }
}
body { margin: 0 auto; max-width: 72rem; padding: 1rem 1.2rem 3rem; background: var(--back); color: var(--text);
  font: 1rem/1.5 system-ui, sans-serif; }
h1 { line-height: 1.2; } h2 { margin-top: 2.5rem; border-bottom: 1px solid var(--line); }
p, figcaption, nav { max-width: 46rem; }
a { color: var(--link); }
.tables { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; min-width: 38rem; margin: 0 0 1.5rem; }
caption { text-align: left; font-weight: 600; padding: .6rem 0 .3rem; }
th, td { text-align: left; vertical-align: top; padding: .25rem .6rem .25rem 0; border-top: 1px solid var(--line); }
th[scope=row] { font-weight: 400; width: 22%; } td.number { font-variant-numeric: tabular-nums; width: 24%; }
td.equation { width: 12%; } thead th { font-size: .85rem; border-top: 0; }
figure { margin: 1.5rem 0 2.5rem; }
.picture { overflow-x: auto; }
figure img { display: block; width: 100%; height: auto; background: #fff; border: 1px solid var(--line);
  border-radius: 4px; }
figcaption { margin-top: .6rem; } figcaption strong { display: block; }
.summary { background: var(--soft); padding: .8rem 1rem; border-left: .3rem solid var(--link); max-width: 46rem; }
footer { margin-top: 3rem; font-size: .9rem; border-top: 1px solid var(--line); }
@media (max-width: 44rem) {
  .picture img { width: 56rem; max-width: none; }
  table { min-width: 0; } thead { display: none; }
  tr { display: block; border-top: 1px solid var(--line); padding: .4rem 0; }
  th[scope=row], td, td.number, td.equation { display: block; width: auto; border: 0; padding: 0; }
  th[scope=row] { font-weight: 600; } td.equation:empty { display: none; }
}
@media print {
  :root { --text: #000; --back: #fff; --soft: #fff; --line: #999; --link: #000; color-scheme: light; }
  body { max-width: none; font-size: 9.5pt; padding: 0; } nav { display: none; } table { min-width: 0; }
  figure, .tables { break-inside: avoid; } h2 { break-after: avoid; }
  figure img { max-height: 22cm; object-fit: contain; }
}
"""


class Picture(NamedTuple):
    """A figure with its words."""

    file_name: str
    title: str
    caption: str
    """What a stranger should see in it."""
    alternative: str
    """What it shows, for someone who cannot see it."""
    content: bytes
    """A PNG file's."""

    @property
    def anchor(self) -> str:
        """Its id on the page."""
        return self.file_name.removesuffix(".png").replace("_", "-")


def page(
    title: str,
    summary: str,
    parameters: Group,
    source: str,
    numbers: Sequence[Group],
    pictures: Sequence[Picture],
    notes: Sequence[str],
) -> str:
    """The whole page. All texts are plain and escaped here."""
    links = [("parameters", "Parameters"), ("numbers", "Numbers")]
    links += [(picture.anchor, picture.title) for picture in pictures]
    contents = "".join(f'<li><a href="#{anchor}">{_text(name)}</a></li>' for anchor, name in links)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<title>{_text(title)}</title>
<style>{STYLE}</style>
</head>
<body>
<header>
<h1>{_text(title)}</h1>
<p class="summary">{_text(summary)}</p>
</header>
<nav aria-label="Contents"><ul>{contents}</ul></nav>
<main>
<section id="parameters">
<h2>Parameters</h2>
<p>Source: {_text(source)}</p>
{_table(parameters)}
</section>
<section id="numbers">
<h2>Numbers</h2>
<p>Equation numbers are those of D. Karnopp, <cite>Vehicle Stability</cite> (2004), chapter 6; &ldquo;derived&rdquo;
follows from them. &ldquo;None&rdquo; says why there is no number.</p>
{"".join(_table(group) for group in numbers)}
</section>
<section id="pictures">
<h2>Pictures</h2>
{"".join(_figure(picture) for picture in pictures)}
</section>
</main>
<footer>
{"".join(f"<p>{_text(note)}</p>" for note in notes)}
</footer>
</body>
</html>
"""


def _table(group: Group) -> str:
    with_equations = any(row.equation for row in group.rows)
    names = ("quantity", "value", *(["equation"] if with_equations else []), "meaning")
    head = "".join(f'<th scope="col">{name}</th>' for name in names)
    rows = "".join(_row(row, with_equations) for row in group.rows)
    return (
        f'<div class="tables"><table><caption>{_text(group.title)}</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>\n"
    )


def _row(row: Quantity, with_equations: bool) -> str:
    equation = f'<td class="equation">{_text(row.equation)}</td>' if with_equations else ""
    return (
        f'<tr><th scope="row">{_text(row.label)}</th><td class="number">{_text(in_words(row))}</td>'
        f"{equation}<td>{_text(row.meaning)}</td></tr>"
    )


def _figure(picture: Picture) -> str:
    content = base64.b64encode(picture.content).decode()
    return (
        f'<figure id="{picture.anchor}"><div class="picture" tabindex="0"><img src="data:image/png;base64,{content}" '
        f'alt="{_text(picture.alternative)}"></div><figcaption><strong>{_text(picture.title)}</strong> '
        f"{_text(picture.caption)}</figcaption></figure>\n"
    )


def _text(words: str) -> str:
    return html.escape(words, quote=True)
