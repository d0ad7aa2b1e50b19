"""The page in the browser: who gets it, who does not, and what it shows and marks."""

import http.client
import json
import signal
import socket
import subprocess
import sys
import threading
import time
from urllib.parse import urlsplit

import browser
import numpy as np
import pytest

import tomojax as tx
from tomojax.hardware import Got, SlotRing
from tomojax.hardware.loop.recorder import Recorder
from tomojax.hardware.web import document, pixels
from tomojax.recordings import attributes

pytest.importorskip("bokeh")
RATE, M = 10_000, 64


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    """A ring with slots of two contacts, its recorder, and the process with the page."""
    folder = tmp_path_factory.mktemp("page")
    ring = SlotRing.create(M, length=1 << 12, folder=folder)
    sensor = tx.Sensor.grid(dtype=np.float32, divisions=(32, 32))
    told = attributes(tx.recordings.Rig.of(sensor, float(RATE)), 5 / 32768, 0.0)
    xy = np.array([[0.05, 0.07], [0.11, 0.1]], np.float32)
    said = {"latency": 5e-4, "next": 3, "flags": int(tx.Flag.HIGH_RESIDUAL), "count": 2}
    said |= {"xy": xy, "conductance": np.array([2e-5, np.nan], np.float32)}
    ring.head["image"][10, 14] = np.nan
    ring.head["image"][20, 20] = 2.0
    recorder = Recorder(ring, folder / "rec.h5", told)
    words = [sys.executable, "-m", "tomojax.hardware.web.live", str(ring.path)]
    process = subprocess.Popen(
        [*words, json.dumps(told), "--recorded"], stderr=subprocess.PIPE, text=True
    )
    assert process.stderr is not None
    url = browser.address(iter(process.stderr.readline, ""))
    stop = threading.Event()

    def feed():
        number = 0
        codes = np.arange(M, dtype="i2")
        while not stop.wait(0.02):
            for _ in range(20):
                ring.put(Got(number % M, 0, number, number / RATE, 0.0), codes, said)
                number += 1

    feeding = threading.Thread(target=feed)
    feeding.start()
    yield ring, url, process, folder / "rec.h5"
    stop.set()
    feeding.join()
    ring.head["done"][...] = 1
    recorder.close()
    assert process.wait(60) == 0
    assert process.stderr.read() == ""  # no stranger has written into the terminal
    process.stderr.close()
    ring.remove()
    with tx.open_recording(folder / "rec.h5") as recording:
        marks = [text for _, text in recording.marks]
    assert marks[:1] == ["the spanner falls"] and "forged" not in marks


def asked(url, path="", method="GET", body=None, **headers):
    """What the server says: the status and the content."""
    where = urlsplit(url)
    one = http.client.HTTPConnection("127.0.0.1", where.port, timeout=30)
    given = {name.replace("_", "-"): value for name, value in headers.items()}
    try:
        one.request(method, where.path + path, body, given)
        answer = one.getresponse()
        return answer.status, answer.read(), dict(answer.getheaders())
    finally:
        one.close()


def test_the_right_user_gets_the_page_and_marks(live):
    ring, url, *_ = live
    status, content, headers = asked(url)
    assert status == 200 and b"page.js" in content
    assert b"http" not in content.replace(b"http-equiv", b"")  # no other host
    assert headers["Referrer-Policy"] == "no-referrer"
    policy = headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy and "eval" not in policy
    assert not [name for name in headers if name.startswith("Access-Control")]
    end = time.monotonic() + 30
    while not (said := json.loads(asked(url, "data?lines=1")[1]))["sources"]:
        assert time.monotonic() < end
        time.sleep(0.05)
    assert said["sources"]["contacts"]["label"] == ["1: 20 µS", "2"]
    assert said["flags"][0][0] == "HIGH_RESIDUAL" and said["flags"][0][1]
    before = int(ring.head["marks"])
    own = f"http://127.0.0.1:{urlsplit(url).port}"
    status, content, _ = asked(url, "mark", "POST", b"the spanner falls", Origin=own)
    assert status == 200 and json.loads(content)["t"] >= 0
    assert int(ring.head["marks"]) == before + 1


def test_pixels_off_the_sheet_are_none_and_json():
    image = np.full((3, 2), np.nan)
    image[1] = 2.0, -1.0
    image[2, 0] = np.inf
    said = pixels(image)
    text = json.dumps(said, allow_nan=False)
    assert json.loads(text)["pixels"] == [None, 1.0, None, None, -0.5, None]
    assert said["top"] == 2.0
    assert pixels(np.full((2, 2), np.nan))["pixels"] == [None] * 4


@pytest.mark.parametrize("holed", [False, True])
def test_the_sheet_is_drawn_by_its_outline(holed):
    edge = tx.Sensor.polygon(
        [[0, 0], [0.1, 0], [0.1, 0.06], [0, 0.06]],
        {"grid": 0.02},
        holes=[[[0.04, 0.02], [0.06, 0.02], [0.05, 0.04]]],
    )
    rig = tx.recordings.Rig.of(edge)
    assert rig.outline is not None
    lines = rig.outline.lines(rig.size) if holed else None
    made = document(rig.size, rig.electrode_xy, (8, 8), "", (0, 1), "", lines)
    text = json.dumps(made, allow_nan=False)  # no NaN, whatever is drawn
    drawn = found(json.loads(text), "MultiLine")[0]
    data = found(json.loads(text), "ColumnDataSource")
    xs = [dict(one["attributes"]["data"]["entries"]).get("xs") for one in data]
    (xs,) = [x for x in xs if x]
    assert drawn["attributes"]["xs"]["field"] == "xs"
    assert [len(x) for x in xs] == ([5, 4] if holed else [5])
    assert max(xs[0]) == pytest.approx(100) and xs[0][0] == xs[0][-1]
    colours = found(json.loads(text), "LinearColorMapper")[0]
    assert colours["attributes"]["nan_color"] == "rgba(0, 0, 0, 0)"


def found(tree, name):
    """All models of a document of that name."""
    each = tree.values() if isinstance(tree, dict) else tree
    some = [tree] if isinstance(tree, dict) and tree.get("name") == name else []
    some = some if "id" in (some or [{}])[0] else []
    return some + [
        m for one in each if isinstance(one, dict | list) for m in found(one, name)
    ]


@pytest.mark.long
def test_a_steps_image_is_empty_off_the_sheet(round_skin):
    touch = tx.Disc.of_total([0.06, 0.04], 0.006, 3e-5)
    volts = np.asarray(tx.voltages(round_skin, touch, [0]))[0]
    for method in ("follow", "linear"):
        step = tx.step.make_step(round_skin, method, "all", contacts=1, grid=24)
        image = np.asarray(step.image(step(step.state, volts, 0)[0]))
        assert np.isnan(image[0, 0]) and np.isfinite(image[12, 12])
        x, y = 100 * (np.indices(image.shape) + 0.5) / 24 - 50
        np.testing.assert_array_equal(np.isnan(image)[np.hypot(x, y) < 47], False)
        np.testing.assert_array_equal(np.isnan(image)[np.hypot(x, y) > 53], True)


def test_strangers_get_nothing_and_change_nothing(live):
    ring, url, *_ = live
    where, before = urlsplit(url), int(ring.head["marks"])
    host = f"127.0.0.1:{where.port}"
    wrong = f"http://{host}/{'x' * 22}/"
    for got in (
        asked(wrong),
        asked(wrong, "data"),
        asked(f"http://{host}/"),
        asked(wrong, "mark", "POST", b"forged"),
        asked(url, "data", Host="evil.example"),  # another name for this machine
        asked(url, "data", Host=f"evil.example:{where.port}"),
        asked(url, "data", Host="127.0.0.1"),
        asked(url, "data", Origin="http://evil.example"),
        asked(url, "data", Origin="null"),
        asked(url, "data", Sec_Fetch_Site="cross-site"),
        asked(url, "mark", "POST", b"forged", Origin="http://evil.example"),
        asked(url, "mark", "OPTIONS", Origin="http://evil.example"),
        asked(url, "mark", "PUT", b"forged"),
    ):
        status, content, headers = got
        assert (status, content) == (403, b"")
        assert "Server" not in headers
    status, content, _ = asked(url, "../../etc/passwd")
    assert (status, content) == (404, b"")
    assert int(ring.head["marks"]) == before


def test_much_is_refused(live):
    ring, url, *_ = live
    before = int(ring.head["marks"])
    try:
        status, content, _ = asked(url, "mark", "POST", b"forged" + bytes(5000))
        assert status >= 400 and not content
    except (ConnectionError, http.client.HTTPException):
        pass  # or it hangs up
    for path in ("?" + "x" * 100_000, "data?from=nan&electrode=-1&t=1e999&to=x"):
        try:
            asked(url, path)
        except (ConnectionError, http.client.HTTPException):
            pass
    assert int(ring.head["marks"]) == before
    assert asked(url, "data")[0] == 200


def test_junk_and_silent_connections_hold_nobody_up(live):
    ring, url, *_ = live
    where, generator = urlsplit(url), np.random.default_rng(0)
    before = int(ring.head["marks"])
    address, silent = ("127.0.0.1", where.port), []
    for k in range(200):  # 10⁴ in tests/benchmarks/web.py
        one = socket.create_connection(address, timeout=10)
        try:
            if k % 3 == 0:
                one.sendall(b"GET /" + b"a" * (k % 50))  # and nothing more
            elif k % 3 == 1:
                one.sendall(generator.bytes(300) + b"\r\n\r\n")
            else:
                line = f"GET {where.path}bokeh.min.js HTTP/1.1\r\nHost: {where.netloc}"
                one.sendall(f"{line}\r\n\r\n".encode())  # and never reads it
        except ConnectionError:
            pass
        silent.append(one)
    began = time.monotonic()
    assert asked(url, "data")[0] == 200
    assert time.monotonic() - began < 10
    for one in silent:
        one.close()
    assert int(ring.head["marks"]) == before


def test_only_this_machine(live):
    url = live[1]
    own = {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None)}
    for other in own - {"127.0.0.1", "::1"}:
        if ":" in str(other) or str(other).startswith("127."):
            continue
        with pytest.raises(OSError):
            socket.create_connection((other, urlsplit(url).port), timeout=2)


@pytest.mark.skipif(browser.found() is None, reason="needs Chromium")
def test_in_a_browser(live):
    pytest.importorskip("websockets")
    ring, url, *_ = live
    with browser.Browser() as page:
        page.go(url)
        page.wait("document.body && document.body.dataset.pictures > 5")
        before = int(ring.head["marks"])
        page.press("m")
        page.wait("document.getElementById('marked').textContent.startsWith('marked')")
        assert int(ring.head["marks"]) == before + 1
        assert "HIGH_RESIDUAL" in page.value("document.getElementById('flagged').innerText")
        drawn = "document.querySelectorAll('.plot')[0].children.length"
        assert page.value(drawn) > 0
        assert page.said == []  # nothing against the policy, no error


def test_the_loop_ends_the_page_not_ctrl_c(live):
    process = live[2]
    process.send_signal(signal.SIGINT)  # is handled before the next request
    assert asked(live[1], "data")[0] == 200 and process.poll() is None
