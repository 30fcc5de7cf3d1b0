"""The report in a browser: nothing is fetched, nothing complains, nothing is wider than the paper."""

import base64

import pytest

from service.report.page import make_report
from service.sinks.session.reader import open_session
from tests.browser.chromium import Chromium, program
from tests.sinks.session.recorded import record_with_evidence

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(program() is None, reason="no Chromium here: the report is NOT tested in a browser"),
]


def test_it_stands_alone_and_fits_the_paper(tmp_path):
    session = open_session(record_with_evidence(tmp_path / "sessions"))
    path = tmp_path / "report.html"
    path.write_text(make_report(session, 1_800_000_000_000_000_000), encoding="utf-8")
    with Chromium() as browser:
        page = browser.page(path.as_uri(), 800, 1100)
        page.wait("document.readyState == 'complete'")
        assert page.complaints == []
        assert [url for url in page.requests if not url.startswith("data:")] == [path.as_uri()]
        assert page.run("document.documentElement.scrollWidth <= innerWidth")
        names = "[...document.querySelectorAll('[id]')].map(e => e.id)"
        assert page.run(f"{names}.length > 10 && {names}.length == new Set({names}).size")
        assert page.run("document.querySelectorAll('svg.picture image').length") == 5
        pdf = base64.b64decode(page.ask("Page.printToPDF", preferCSSPageSize=True)["data"])
    assert pdf.startswith(b"%PDF")
    assert b"/MediaBox [0 0 594.95996 841.91998]" in pdf or b"/MediaBox [0 0 595" in pdf
