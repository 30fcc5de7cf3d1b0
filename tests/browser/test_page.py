"""The operator's page in a real browser; skipped where there is none."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from service.console.watched import SourceStatus
from tests.browser.chromium import PATIENCE_S, Chromium, program
from tests.browser.served import Served, aligner_at
from tests.fakes.drawn import made_up
from tests.fakes.station import TOKENS

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(program() is None, reason="NO BROWSER: the operator's page is NOT TESTED (Debian: chromium)"),
]
ROOT = Path(__file__).parents[2]
LIVE = SourceStatus("LIVE", capture_fps=25.0, inputs=("CH1", "CH2"), input="CH1")
HIDDEN = "document.getElementById('banner').hidden"
HAND = "document.getElementById('hand').getAttribute('transform')"
SHOWN = """
document.body.dataset.drawMs !== undefined && document.body.dataset.liveness !== undefined
  && !document.body.classList.contains('dead')
"""
ON_TOP = """
(box => document.getElementById('banner').contains(
  document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2)))(
  document.getElementById('banner').getBoundingClientRect())
"""


@pytest.fixture(scope="module")
def chromium():
    with Chromium() as browser:
        yield browser


@pytest.fixture
def open_page(chromium):
    """Serve a station and open its page; each test ends without a complaint or a request to elsewhere."""
    opened = []

    def start(path="", **station):
        served = Served(**station).__enter__()
        page = chromium.page(served.url + path)
        opened.append((served, page))
        page.station, page.served = served.station, served
        if not station.get("tokens"):
            page.wait(SHOWN)
        return page

    yield start
    for served, page in opened:
        complaints = [c for c in page.complaints if "401" not in c and "409" not in c and "WebSocket" not in c]
        elsewhere = [url for url in page.requests if not url.startswith((served.url, f"ws://127.0.0.1:{served.port}/"))]
        page.ask("Network.clearBrowserCookies")  # the next test may get the same port
        page.ask("Page.close")
        served.__exit__()
        assert complaints == []
        assert elsewhere == []


def says(selector, words):
    """An expression: whether an element says so."""
    return f"document.querySelector({selector!r}).innerText.includes({words!r})"


def await_new_picture(page):
    """Wait for a picture drawn from now on: it has the size that its place has now."""
    before = page.run(HAND)
    page.wait(f"{HAND} !== {before!r}")


def at_tube(page, row, column):
    """Where on the screen a tube is, by the results of `made_up`."""
    await_new_picture(page)
    tubes = made_up(0, size=(640, 480))[1].measurement.tubes
    [i] = [i for i in range(len(tubes)) if (tubes.row[i], tubes.column[i]) == (row, column)]
    x, y = tubes.center_px[i] + 0.5
    box = json.loads(page.run("JSON.stringify(document.getElementById('picture').getBoundingClientRect())"))
    return box["x"] + x / 640 * box["width"], box["y"] + y / 480 * box["height"]


def test_the_heartbeat_turns_with_the_frames_and_stops_with_them(open_page):
    page = open_page()
    page.wait(f"document.body.dataset.liveness === 'LIVE' && {HIDDEN}")
    await_new_picture(page)
    page.served.streams.clear()  # the service goes on to say LIVE: the page believes what it sees
    page.wait(f"document.body.dataset.liveness === 'STALE' && {says('#banner', 'no new picture')}")
    still = page.run(HAND)
    time.sleep(0.3)
    assert page.run(HAND) == still
    assert page.run("document.body.classList.contains('dead')")
    page.served.streams.set()
    page.wait(f"document.body.dataset.liveness === 'LIVE' && {HIDDEN}")


@pytest.mark.parametrize("word", ["FROZEN", "NO SIGNAL", "STALE", "RECONNECTING", "ENDED"])
def test_a_picture_that_is_not_live_wears_a_banner_that_nothing_hides(open_page, word):
    page = open_page()
    page.station.watched.shown = SourceStatus(word, "for the test", since_ns=time.monotonic_ns() - 7_000_000_000)
    page.wait(
        f"['bannerword', 'liveness'].every(id => document.getElementById(id).innerText === {word!r})"
        f" && {says('#banner', 'for the test')} && !{HIDDEN} && {ON_TOP}"
    )
    hand = page.run(HAND)
    time.sleep(0.3)
    assert page.run(HAND) == hand
    for key in ("Escape", "k", "s", "x"):
        page.key(key)
    page.click_on("#banner")
    assert not page.run(HIDDEN)
    page.station.watched.shown = LIVE
    page.wait(HIDDEN)


@pytest.mark.parametrize("kind", ["REPLAY", "SIMULATED"])
def test_what_is_not_live_never_looks_live(open_page, kind):
    page = open_page(kind=kind)
    page.wait(f"document.body.dataset.liveness === {kind!r}")
    assert kind in page.text("#kindstrip")
    assert page.run("document.getElementById('kindstrip').getBoundingClientRect().height") > 10
    assert kind.lower() in page.text("#tiltquality")
    assert "LIVE" not in page.text("header")


def test_a_service_that_is_gone_makes_the_page_stale_by_itself(open_page):
    page = open_page()
    page.served.streams.clear()
    page.served.server.close(10.0)
    page.wait(f"document.body.dataset.liveness === 'STALE' && {says('#banner', 'tries again')}")


def test_a_click_chooses_the_tube_under_it(open_page):
    page = open_page()
    page.click(*at_tube(page, 1, -1))
    page.wait("document.getElementById('tube').innerText === 'row 1, column -1'")
    assert page.station.operations.target.place == (1, -1)
    page.click(*at_tube(page, 0, 0))
    page.wait("document.getElementById('tube').innerText === 'row 0, column 0'")
    assert page.station.operations.target.place == (0, 0)


def test_the_keyboard_does_all_that_the_mouse_does(open_page):
    page = open_page(aligner=aligner_at(0.6, 0.0))
    page.key("t")
    page.wait("document.getElementById('ask').open")
    page.type("0,0")
    page.key("Enter")
    page.wait("!document.getElementById('ask').open")
    assert page.station.operations.target.place == (0, 0)
    page.key("ArrowRight")
    page.wait("document.getElementById('tube').innerText === 'row 0, column 1'")
    page.key("ArrowUp")
    page.wait("document.getElementById('tube').innerText === 'row -1, column 1'")
    page.key("n")
    page.wait("document.getElementById('tube').innerText === 'row 0, column 0'")
    page.key("?")
    page.wait("document.getElementById('help').open")
    assert "acknowledge" in page.text("#help")
    page.key("Escape")
    page.wait("!document.getElementById('help').open")


def test_moves_pressed_before_the_picture_shows_the_last_one_go_on_from_there(open_page):
    page = open_page(aligner=aligner_at(0.6, 0.0))
    page.click(*at_tube(page, 0, -1))
    for key in ("ArrowRight", "ArrowRight", "ArrowUp"):
        page.key(key)
    page.wait("document.getElementById('tube').innerText === 'row -1, column 1'")
    assert page.station.operations.target.place == (-1, 1)


@pytest.mark.parametrize(("key", "dialog"), [("t", "ask"), ("?", "help")])
def test_a_key_pressed_the_moment_a_dialog_closes_counts(open_page, key, dialog):
    page = open_page()
    page.key(key)
    page.wait(f"document.getElementById({dialog!r}).open")
    pressed = "document.activeElement.dispatchEvent(new KeyboardEvent('keydown', { key: 'm', bubbles: true }))"
    assert page.run(f"document.getElementById({dialog!r}).close(); {pressed}; asktitle.textContent") == "Mark"


def test_a_wrong_name_is_refused_in_the_dialog_in_words(open_page):
    page = open_page()
    page.key("t")
    page.wait("document.getElementById('ask').open")
    page.type("nonsense")
    page.key("Enter")
    page.wait("document.getElementById('askproblem').innerText.includes('cannot be read')")
    assert page.run("document.getElementById('ask').open")


def test_an_anchor_names_the_tubes(open_page):
    page = open_page(aligner=aligner_at(0.0, 0.0))
    page.key("a")
    page.click(*at_tube(page, 0, 0))
    page.wait("document.getElementById('ask').open")
    page.type("row 12 col 34")
    page.key("Enter")
    page.wait("document.getElementById('tube').innerText === 'SG1 HL ROW12 COL34'")
    page.click(*at_tube(page, 0, 1))
    page.wait("document.getElementById('tube').innerText === 'SG1 HL ROW12 COL35'")
    assert "columns grow right, rows up" in page.text("#where")


def test_offset_and_verdict_are_told_with_sigma_and_quality(open_page):
    page = open_page(aligner=aligner_at(0.6, 0.0))
    page.click(*at_tube(page, 0, 0))
    page.wait("document.getElementById('offset').innerText.startsWith('0.6')")
    assert "±" in page.text("#offset")
    assert "mm" in page.text("#offset")
    assert "right 0.60" in page.text("#offsetparts")
    assert page.text("#offsetquality").strip() in ("good", "uncertain")


def test_an_alarm_appears_is_acknowledged_and_stays_until_it_clears(open_page):
    page = open_page()
    page.station.watched.shown = SourceStatus("FROZEN", "the same byte for byte")
    page.wait("document.querySelector('#alarmlist li.new')")
    alarm = page.text("#alarmlist li")
    for words in ("FIRST", "FROZEN: the same byte for byte", "stop moving", "UTC", "not acknowledged"):
        assert words in alarm
    page.key("k")
    page.wait("document.querySelector('#alarmlist li:not(.new)')")
    assert "acknowledged" in page.text("#alarmlist li")
    assert page.station.desk.list.alarms
    page.station.watched.shown = LIVE
    page.wait("!document.querySelector('#alarmlist li')")


def test_an_alarm_that_went_by_itself_stays_until_it_is_acknowledged(open_page):
    page = open_page()
    page.station.watched.shown = SourceStatus("NO SIGNAL", "the input has no signal")
    page.wait("document.querySelector('#alarmlist li.new')")
    page.station.watched.shown = LIVE
    page.wait("document.querySelector('#alarmlist li.gone.new')")
    page.click_on("#alarmlist button")
    page.wait("!document.querySelector('#alarmlist li')")


def test_an_acknowledgement_counts_although_the_list_is_told_anew_while_the_button_is_down(open_page):
    page = open_page()
    page.station.watched.shown = SourceStatus("NO SIGNAL", "the input has no signal")
    page.wait("document.querySelector('#alarmlist button')")
    place, when = page.middle("#alarmlist button"), page.text("#alarmlist .when")
    page.mouse("mousePressed", *place)
    page.wait(f"document.querySelector('#alarmlist .when').innerText !== {when!r}")
    page.mouse("mouseReleased", *place)
    page.wait("document.querySelector('#alarmlist li:not(.new)')")


def test_sessions_are_begun_marked_verified_and_ended(open_page):
    page = open_page()
    page.key("r")
    page.wait("document.getElementById('recorded').innerText.startsWith('REC')")
    page.key("v")
    page.wait("document.getElementById('ask').open")
    page.type("row 3 col 5")
    page.key("Enter")
    page.wait("document.getElementById('said').innerText.includes('THE PICTURE SAYS ROW3 COL4')")
    page.key("m")
    page.wait("document.getElementById('ask').open")
    page.key("Enter")
    page.wait("document.getElementById('said').innerText.includes('evidence record 1')")
    assert [what[0] for what in page.station.recorder.asked] == ["verify", "mark"]
    page.key("r")
    page.wait("document.getElementById('ask').open")
    page.click_on("#askdone")
    page.wait("document.getElementById('recorded').innerText === 'off'")


def test_an_input_is_chosen_and_a_refusal_is_told(open_page):
    page = open_page()
    page.wait("!document.getElementById('inputs').hidden")
    choose = "(s => { s.value = 'CH2'; s.dispatchEvent(new Event('change')); })(document.getElementById('input'))"
    page.run(choose)
    page.wait("document.getElementById('said').innerText.includes('does not answer')")


def test_a_page_that_may_only_watch_cannot_operate(open_page):
    page = open_page(f"#token={TOKENS.view}", tokens=TOKENS)
    page.wait(SHOWN)
    assert page.run("location.hash") == ""
    page.wait("document.querySelector('[data-do=record]').disabled")
    page.click(*at_tube(page, 0, 0))
    page.key("r")
    time.sleep(0.3)
    assert page.station.recorder.state.folder is None
    assert str(page.station.operations.target) == "nearest"


def test_a_token_is_asked_for_and_a_wrong_one_refused(open_page):
    page = open_page(tokens=TOKENS)
    page.wait("document.getElementById('ask').open")
    page.type("guess")
    page.key("Enter")
    page.wait("document.getElementById('askproblem').innerText.includes('not a token')")
    page.run("document.querySelector('#ask input').value = ''")
    page.type(TOKENS.control)
    page.key("Enter")
    page.wait("document.body.dataset.drawMs !== undefined")
    page.wait("!document.querySelector('[data-do=record]').disabled")


@pytest.mark.parametrize("size", [(1280, 720), (1920, 1080)])
def test_everything_has_room(open_page, size):
    page = open_page(aligner=aligner_at(0.6, 0.2))
    page.size(*size)
    page.station.watched.shown = SourceStatus("LIVE", inputs=("S-Video 1", "S-Video 2"), input="S-Video 1")
    page.wait(says("#input", "S-Video 2"))
    page.click(*at_tube(page, 0, 0))
    page.wait("document.querySelector('#alarmlist li')")
    await_new_picture(page)
    outside = page.run(
        "[...document.querySelectorAll('header *, aside section, figure, output, footer button, footer input')]"
        ".filter(e => e.getClientRects().length && (e.getBoundingClientRect().right > innerWidth + 1"
        " || e.getBoundingClientRect().bottom > innerHeight + 1)).map(e => e.id || e.textContent)"
    )
    assert outside == []
    picture = json.loads(page.run("JSON.stringify(document.getElementById('picture').getBoundingClientRect())"))
    assert picture["width"] * picture["height"] > 0.45 * size[0] * size[1]


REAL_SERVICE = """
import sys
from drivers.faults import Fault, FaultKind
from drivers.opening import open_grabber
from drivers.simulated import SimulatedGrabber
from service.cli import main, run
from service.console.console import Console

def announce(console, told=Console.announce):
    told(console)
    sys.stdin.readline()  # the first frame comes once the page looks on

Console.announce = announce
faults = [
    Fault(FaultKind.FREEZE, 150, frames=75),
    Fault(FaultKind.BLACK, 300, frames=75),
    Fault(FaultKind.DISCONNECT, 450, seconds=4.0),
]
scene = open_grabber("simulated:model-f?size=640x480&loop_frames=4").scene
run._grabber = lambda station: SimulatedGrabber(scene, loop_frames=4, faults=faults)
sys.exit(main(["run", "--config", sys.argv[1], "--no-viewer"]))
"""
WORDS = "SIMULATED", "FROZEN", "SIMULATED", "NO SIGNAL", "SIMULATED", "RECONNECTING", "SIMULATED"
NOTE_WORDS = """
globalThis.words = [];
new MutationObserver(() => words.push(document.body.dataset.liveness)).observe(
  document.body, { attributeFilter: ["data-liveness"] });
"""


def test_the_real_service_with_a_source_that_fails(chromium, tmp_path):
    station = tmp_path / "s.toml"
    station.write_text('[source]\ndevice = "simulated"\n[generator]\nname = "model-f"\n[console]\nclients = 2\n')
    command = [sys.executable, "-c", REAL_SERVICE, station]
    with subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as service:
        try:
            said = next(line for line in service.stdout if line.startswith("operator's page: "))
            page = chromium.page(said.split()[-1])
            page.wait("document.body.dataset.liveness === 'STARTING'")
            page.run(NOTE_WORDS)
            service.stdin.write("\n")
            service.stdin.flush()
            in_order = "words.reduce((at, word) => at + (word === wanted[at]), 0) === wanted.length"
            page.wait(f"(wanted => {in_order})({list(WORDS)})")
            for key in ("source frozen", "source no signal", "source reconnecting"):  # looked for a few times a second
                page.wait(f"document.querySelector('#alarmlist li.gone[data-key=\"{key}\"]') !== null")
            page.close()
        finally:
            service.send_signal(signal.SIGINT)
            service.communicate(timeout=PATIENCE_S)
