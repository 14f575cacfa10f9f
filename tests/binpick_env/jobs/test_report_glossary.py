import re
from pathlib import Path

from binpick_env.jobs.report_glossary import TERMS, glossary
from binpick_env.jobs.report_style import figure, page, tile

SITE = Path(__file__).resolve().parents[3] / "docs/explanation/numbers.md"


def terms_of(section: str) -> list[str]:
    return re.findall(r"<dt>(.*?)</dt>", section)


def test_every_term_is_one_of_the_sites_glossary():
    defined = re.findall(r"^(.+)\n: ", SITE.read_text(encoding="utf-8"), re.MULTILINE)
    assert {term for term, _, _ in TERMS} <= set(defined)


def test_a_page_explains_the_terms_that_it_uses_and_no_others():
    shown = page("a run", tile("GSR · grasp success", "98 %", "of 40 attempts"))
    assert terms_of(shown) == ["Attempt", "GSR (grasp success rate)"]
    assert "Delivered parts divided by attempts." in shown


def test_what_is_not_read_as_text_uses_no_term():
    pictures = figure("data:image/png;base64,AAA/DR+AP/GSR", "the bin", "from above")
    assert glossary(pictures + "<p><code>binpick pick --push</code></p>") == ""


def test_outcomes_are_found_however_they_are_written():
    assert terms_of(glossary("<p>not_settled</p>")) == terms_of(glossary("<p>left the bin</p>")) == ["Outcome"]
