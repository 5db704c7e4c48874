"""The documentation site: it builds, is complete, and works in a browser without a network."""

import re
import subprocess
import sys
from contextlib import contextmanager

import pytest

import skystack
from tests.docs.blocks import ROOT, blocks
from tests.reporting.replay.browser import LAPTOP, PHONE, TIMEOUT_MS

NAMES = [name for name in skystack.__all__ if not name.startswith("_")]
READERS = {
    "A first policy": {"start.md", "concepts.md"},
    "Your own sector or task": {"formats.md", "extending.md"},
    "Your own agent": {"environments.md", "platforms.md"},
    "A whole sector": {"sector-control.md"},
    "The paper's numbers": {"faithfulness.md"},
}


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the site, built as where the packages of extras are missing."""
    pytest.importorskip("sphinx")
    folder = tmp_path_factory.mktemp("documentation") / "site"
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "docs", str(folder)]
    command += ["-D", "autodoc_mock_imports=stable_baselines3,pettingzoo"]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    return folder


@pytest.fixture(scope="module")
def pages(site):
    """The parsed pages by their paths."""
    parser = pytest.importorskip("bs4").BeautifulSoup
    return {
        path.relative_to(site).as_posix(): parser(path.read_text(), "html.parser")
        for path in site.rglob("*.html")
    }


@pytest.mark.slow
def test_pages_load_nothing_from_the_network(pages):
    for name, page in pages.items():
        loaded = [each.get("src") or each.get("href") for each in page(["script", "link", "img"])]
        assert not [url for url in loaded if url and url.startswith(("http:", "https:", "//"))], (
            name
        )


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_every_top_level_name_has_an_entry_with_an_example(name, pages):
    entry = pages["api.html"].find(id=f"skystack.{name}").find_next_sibling("dd")
    assert entry.find("p").text
    assert "Example:" in [each.text for each in entry("p")]
    assert ">>> " in entry.select_one("div.highlight").text


@pytest.mark.slow
def test_every_package_has_a_page(pages):
    linked = {link["href"] for link in pages["api.html"].select("article li.toctree-l1 a")}
    assert linked == {name for name in pages if name.startswith("api/")}
    entries = {each["id"] for name in linked for each in pages[name].select("dt.sig[id]")}
    assert {
        "skystack.stacking.belongs",
        "skystack.tasks.kinds.TaskKind",
        "skystack.gym.stacked.StackedEnvironment",
        "skystack.evaluation.evaluate.Evaluation.failed",
    } <= entries
    assert "skystack.evaluation.evaluate.evaluate" not in entries  # only as skystack.evaluate


@pytest.mark.slow
def test_fields_have_their_own_texts_or_none(pages):
    assert [name for name, page in pages.items() if "Alias for field number" in page.text] == []
    field = pages["api.html"].find(id="skystack.Stack.action").find_next_sibling("dd")
    assert "first action in the cycle" in field.text


@pytest.mark.slow
def test_every_table_is_in_a_scrolling_box(pages):
    tables = {name: page.select("table.docutils") for name, page in pages.items()}
    assert len(tables["faithfulness.html"]) > 10
    for name, found in tables.items():
        for table in found:
            assert "table-wrapper" in table.parent["class"], name
            assert all({"short", "long"} & set(cell["class"]) for cell in table("td")), name


@pytest.mark.slow
def test_options_keep_their_hyphens(pages):
    assert "skystack --help" in pages["benchmarks.html"].text


def test_landing_page_has_a_command_a_picture_and_links_for_each_reader():
    page = ROOT / "docs" / "index.md"
    text = page.read_text()
    assert [block.text for block in blocks(page) if block.language == "command"] == [
        "python3 dev.py reproduce"
    ]
    assert len(re.findall(r"!\[.+\]\(images/\S+\)", text)) == 1
    readers = dict(re.findall(r"^- \*\*(.+?)\.\*\* (.*?)\n(?=- |\n)", text, re.DOTALL | re.M))
    linked = {name: set(re.findall(r"\]\(([\w-]+\.md)", each)) for name, each in readers.items()}
    assert linked.keys() == READERS.keys()
    assert {name for name, wanted in READERS.items() if not wanted <= linked[name]} == set()


@contextmanager
def opened(browser, path, query="", viewport=LAPTOP, color_scheme="light"):
    """A page of the site, opened from its file."""
    page = browser.new_page(viewport=viewport, color_scheme=color_scheme)
    page.set_default_timeout(TIMEOUT_MS)
    problems = []
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.goto(f"{path.as_uri()}{query}")
    yield page
    page.close()
    assert problems == []


@pytest.mark.slow
@pytest.mark.parametrize("viewport", [LAPTOP, PHONE], ids=["laptop", "phone"])
def test_wide_tables_scroll_and_never_break_numbers(viewport, site, browser):
    with opened(browser, site / "faithfulness.html", viewport=viewport) as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= viewport["width"]
        boxes = page.evaluate(
            "[...document.querySelectorAll('.table-wrapper')].map(box => [getComputedStyle(box)"
            ".overflowX, box.scrollWidth > box.clientWidth])"
        )
        assert {overflow for overflow, _ in boxes} == {"auto"}
        assert any(scrolls for _, scrolls in boxes)
        # A text on one line has one box.
        broken = page.evaluate(
            """[...document.querySelectorAll("td.short p")].filter(text => {
                const range = document.createRange();
                range.selectNodeContents(text);
                return new Set([...range.getClientRects()].map(box => box.bottom)).size > 1
                    && !text.children.length;
            }).map(text => text.textContent)"""
        )
        assert broken == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["index", "api", "api/learning", "benchmarks", "command-line"])
def test_page_fits_a_phone(name, site, browser):
    with opened(browser, site / f"{name}.html", viewport=PHONE) as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]


@pytest.mark.slow
def test_search_works_from_files(site, browser):
    assert (site / "searchindex.js").stat().st_size > 10_000
    with opened(browser, site / "index.html") as page:
        page.fill("input[name=q]", "clearance")
        page.press("input[name=q]", "Enter")
        page.wait_for_selector("#search-results ul.search li")
        page.wait_for_function("document.querySelector('.search-summary').innerText.match(/found/)")
        links = page.eval_on_selector_all(
            "#search-results li a", "links => links.map(link => link.getAttribute('href'))"
        )
        assert len(links) > 10
        assert any(link.startswith("concepts.html") for link in links)
        with page.expect_navigation():
            page.click("#search-results li a[href^='concepts.html']")
        assert "concepts.html" in page.url
        assert page.inner_text("h1").startswith("Concepts")
