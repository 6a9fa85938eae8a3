"""`skhyst app` in a browser: from a measured recording to the named effect and a model to keep."""

import shutil
import socket
import subprocess
import sys
import time
from contextlib import suppress
from http.client import HTTPConnection
from urllib.request import urlopen

import pytest
from recordings import load_piezo_afm

from skhyst.app._samples import SAMPLES
from skhyst.persistence import load_model

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
FLAGS = (
    "--no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync"
)
PATIENCE = 180.0  # s, of a busy machine with an empty cache


@pytest.fixture(scope="module")
def address():
    """Address of a page that is served by the command."""
    for module in ("streamlit", "skops", "matplotlib"):
        pytest.importorskip(module)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "skhyst", "app", "--no-browser", "--port", str(port)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as server:
        yield _answering(f"http://127.0.0.1:{port}", server)
        server.terminate()


def _answering(address, server):
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end and server.poll() is None:
        try:
            urlopen(f"{address}/_stcore/health", timeout=5.0).close()
            return address
        except OSError:
            time.sleep(0.2)
    raise AssertionError("the page is not served")


@pytest.fixture
def page():
    playwright = pytest.importorskip("playwright.sync_api")
    if CHROMIUM is None:
        pytest.skip("there is no chromium")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS.split())
        page = browser.new_page()
        page.set_default_timeout(1e3 * PATIENCE)
        yield page
        browser.close()


@pytest.fixture
def recording(tmp_path):
    """A part of a measured recording, as a file of a laboratory."""
    X, y, *_ = load_piezo_afm()
    table = X.assign(gauge=y).iloc[::4].reset_index("time", drop=True)
    table.columns = ["voltage [V]", "gauge [counts]"]
    table.to_csv(tmp_path / "scanner.csv", index=False)
    return tmp_path / "scanner.csv"


def insist(act, seen):
    """Act until it is seen: what is clicked while the page is drawn anew is lost."""
    from playwright.sync_api import TimeoutError as Missed

    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        with suppress(Missed):
            act()
            seen.wait_for(timeout=5e3)
            return
    raise AssertionError(f"{seen} does not appear")


def declare(page, name, *effects):
    """Declare a model, and the effects to search for."""
    model = page.get_by_role("textbox", name="Model", exact=True)
    model.fill(name)
    model.press("Enter")
    page.get_by_text("To declare one of your own").wait_for(state="detached")
    list_of_effects = page.get_by_role("combobox", name="Effects")
    options = page.get_by_text("Options", exact=True).last  # of two while it is drawn anew
    insist(lambda: options.click(timeout=5e3), list_of_effects)
    chosen = page.locator("[data-tag], [data-baseweb=tag]")  # of newer and older Streamlit
    for effect in effects:
        option = page.get_by_role("option", name=effect, exact=True)

        def choose(effect=effect, option=option):
            list_of_effects.fill(effect, timeout=5e3)
            option.click(timeout=5e3)

        insist(choose, chosen.filter(has_text=effect).first)
    list_of_effects.press("Escape")


def begin(page):
    """Begin a search."""
    search, stop = (page.get_by_role("button", name=name) for name in ("Search", "Stop"))
    insist(lambda: search.click(timeout=5e3), stop)


@pytest.mark.slow
def test_other_names_and_frames_are_refused(address):
    """A page elsewhere that makes its own name mean this machine sends that name."""
    port = int(address.rpartition(":")[2])
    websocket = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13"}
    websocket |= {"Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ=="}

    def asked(path, host, **headers):
        connection = HTTPConnection("127.0.0.1", port, timeout=PATIENCE)
        origin = {"Host": host, "Origin": f"http://{host}"}
        connection.request("GET", path, headers=origin | headers)
        answer = connection.getresponse()
        connection.close()
        return answer.status, answer.headers

    for host in (f"127.0.0.1:{port}", f"localhost:{port}"):
        status, headers = asked("/", host)
        assert (status, headers["X-Frame-Options"]) == (200, "SAMEORIGIN")
        policy = headers["Content-Security-Policy"]
        assert "default-src 'self'" in policy
        assert "frame-ancestors 'self'" in policy
        assert asked("/_stcore/stream", host, **websocket)[0] == 101
    for host in (f"attacker.example:{port}", f"127.0.0.1.attacker.example:{port}"):
        assert asked("/", host)[0] == 400
        assert asked("/_stcore/stream", host, **websocket)[0] in (400, 403)


@pytest.mark.slow
@pytest.mark.needs_recordings("piezo_afm")
def test_from_a_measured_recording_to_a_model_that_is_kept(page, address, recording, tmp_path):
    """Every state of the page on the way, on a screen and on a telephone."""
    asked = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(address)
    page.locator("input[type=file]").set_input_files(recording)
    page.get_by_text("sampling rate unknown").wait_for()
    declare(page, "prandtl_ishlinskii", "asymmetry", "lag")
    begin(page)
    page.get_by_role("button", name="Stop").click()
    page.get_by_text("Stopped: the search of scanner.csv. Nothing of it is kept.").wait_for()
    assert page.get_by_role("heading", name="Searches").count() == 0
    begin(page)
    page.get_by_role("heading", name="Missing: asymmetry").wait_for()
    assert page.get_by_text("Stopped:").count() == 0
    page.get_by_test_id("stTable").filter(has_text="scanner.csv").wait_for()
    report = page.frame_locator("iframe").get_by_role("heading", name="Missing: asymmetry")
    report.wait_for()
    with page.expect_download() as download:
        page.get_by_role("button", name="Download the model").click()
    download.value.save_as(tmp_path / "model.skops")
    assert "asymmetry" in load_model(tmp_path / "model.skops").named_steps
    page.set_viewport_size({"width": 400, "height": 800})
    width = "() => document.querySelector('[data-testid=stMain]').scrollWidth"
    page.wait_for_function(f"() => ({width})() <= 400")
    elsewhere = [url for url in asked if url.startswith("http") and not url.startswith(address)]
    assert elsewhere == []


@pytest.mark.slow
def test_a_search_goes_on_where_that_of_another_session_is_stopped(page, address):
    other = page.context.browser.new_page()
    other.set_default_timeout(1e3 * PATIENCE)
    # all effects take longer than the other search: what is stopped is not over
    for session, effects in ((page, ()), (other, ("creep", "resonance"))):
        session.goto(address)
        session.get_by_role("combobox", name="Or a recording to try").click()
        session.get_by_role("option", name=SAMPLES[0]).click()
        session.get_by_text("1500 samples in 1 record").wait_for()
        declare(session, "prandtl_ishlinskii", *effects)
    for session in (page, other):
        begin(session)
    page.get_by_role("button", name="Stop").click()
    page.get_by_text("Stopped: the search of").wait_for()
    other.get_by_role("heading", name="Missing: creep").first.wait_for()
    assert other.get_by_text("Stopped:").count() == 0
    assert page.get_by_role("heading", name="Missing: ").count() == 0
