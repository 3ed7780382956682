#!/usr/bin/env python3
"""Opens report pages in headless Chromium, and looks for what no Rust test sees.

    python3 benches/report_page.py PAGE.html [PAGE.html ...] [--shots DIR] [--browser PATH]

Every page is opened at 1400 and at 390 pixels, in light and in dark. A page fails if its console has an error or a warning, if a script
throws, if it asks for anything but itself, if it is wider than the window, if a canvas is blank, or if a card is empty. With `--shots`,
the first screen and the whole page of every view are written as PNG files. The clock is moved and every selector is turned once.

Needs Python 3.9 and Chromium (the Debian package `chromium`, or any Chrome; `--browser` or CHROMIUM names it), and no Python package:
the browser is driven over a pipe by the DevTools protocol. Without a browser it says so and ends with code 0, as a skipped check.
"""

import argparse
import base64
import json
import os
import pathlib
import select
import shutil
import subprocess
import sys
import tempfile
import time

NAMES = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome"]
VIEWS = [(width, scheme) for width in (1400, 390) for scheme in ("light", "dark")]
PATIENCE = 900.0  # seconds: a page that takes longer hangs, however busy the machine

# What a person would see at once: nothing beyond the right edge, no blank canvas, no empty card. The answer is a list of faults.
FAULTS = """(() => {
  const faults = [], width = document.documentElement.clientWidth;
  if (document.documentElement.scrollWidth > width) {
    const wide = [...document.querySelectorAll('main *, header *')].filter((e) => e.getBoundingClientRect().right > width + 1);
    faults.push(`${document.documentElement.scrollWidth} px wide in ${width} px: ` + [...new Set(wide.map((e) => e.tagName + '.' + e.className))].slice(0, 4));
  }
  for (const box of document.querySelectorAll('.wide'))
    if (box.scrollWidth > box.clientWidth + 1 && width < 640) faults.push(`a table of ${box.scrollWidth} px in ${box.clientWidth} px`);
  for (const canvas of document.querySelectorAll('canvas')) {
    const { width: w, height: h } = canvas;
    const pixels = w && h ? canvas.getContext('2d').getImageData(0, 0, w, h).data : [];
    const seen = new Set();
    for (let i = 0; i < pixels.length && seen.size < 8; i += 4) seen.add(pixels[i] << 16 | pixels[i + 1] << 8 | pixels[i + 2]);
    if (seen.size < 8) faults.push(`a canvas (${canvas.className || 'motion'}) with ${seen.size} colors`);
  }
  for (const card of document.querySelectorAll('.card')) if (!card.textContent.trim() && !card.querySelector('canvas, svg')) faults.push('an empty card');
  for (const plot of document.querySelectorAll('.plot')) if (!plot.querySelector('path')) faults.push('a chart without a curve');
  if (!document.querySelector('h1')) faults.push('no heading');
  if (/NaN|undefined|Infinity|\\[object/.test(document.body.innerText)) faults.push('says ' + document.body.innerText.match(/.{0,40}(NaN|undefined|Infinity|\\[object).{0,20}/)[0]);
  return faults;
})()"""

# Moves whatever moves: errors of handlers show in the console.
EXERCISE = """(async () => {
  const frame = () => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
  const slider = document.querySelector('input[type=range]');
  if (slider) for (const v of [0, 300, 1000]) { slider.value = v; slider.dispatchEvent(new Event('input')); await frame(); }
  for (const select of document.querySelectorAll('select')) {
    const first = select.value;
    for (const option of select.options) { select.value = option.value; select.dispatchEvent(new Event('change')); await frame(); }
    select.value = first; select.dispatchEvent(new Event('change'));
  }
  for (const button of document.querySelectorAll('button[aria-pressed]')) { button.click(); await frame(); button.click(); }
  for (const key of ['ArrowLeft', 'Home', 'End', ' ', ' ']) { document.body.dispatchEvent(new KeyboardEvent('keydown', { key, bubbles: true })); await frame(); }
  for (const target of document.querySelectorAll('canvas, .plot')) {
    const box = target.getBoundingClientRect();
    target.dispatchEvent(new PointerEvent('pointermove', { clientX: box.left + box.width / 2, clientY: box.top + box.height / 2, pointerId: 1, bubbles: true }));
    target.dispatchEvent(new PointerEvent('pointerleave', { pointerId: 1, bubbles: true }));
    await frame();
  }
  return 'done';
})()"""


class NoBrowser(Exception):
    """The browser does not work here."""


class Browser:
    """Chromium on a pipe: messages of the DevTools protocol, each ended by a zero byte."""

    def __init__(self, path, profile):
        to_read, self.to = os.pipe()
        self.source, from_write = os.pipe()

        def own_pipes():
            # The browser reads commands from 3 and writes answers to 4; copies first, since either may be one of these numbers.
            commands, answers = os.dup(to_read), os.dup(from_write)
            os.dup2(commands, 3)
            os.dup2(answers, 4)

        self.process = subprocess.Popen(
            [path, "--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--remote-debugging-pipe",
             "--no-first-run", "--disable-extensions", "--disable-background-networking", f"--user-data-dir={profile}", "about:blank"],
            preexec_fn=own_pipes, close_fds=False, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        os.close(to_read)
        os.close(from_write)
        self.rest, self.number, self.events = b"", 0, []

    def message(self):
        while b"\0" not in self.rest:
            ready, _, _ = select.select([self.source], [], [], PATIENCE)
            more = os.read(self.source, 1 << 20) if ready else b""
            if not more:
                self.process.kill()
                raise NoBrowser("it ended" if ready else f"it said nothing for {PATIENCE:.0f} s")
            self.rest += more
        text, self.rest = self.rest.split(b"\0", 1)
        return json.loads(text)

    def ask(self, method, session=None, **parameters):
        self.number += 1
        command = {"id": self.number, "method": method, "params": parameters}
        if session:
            command["sessionId"] = session
        os.write(self.to, json.dumps(command).encode() + b"\0")
        started = time.monotonic()
        while time.monotonic() - started < PATIENCE:
            message = self.message()
            if message.get("id") == self.number:
                if "error" in message:
                    raise SystemExit(f"{method}: {message['error']}")
                return message["result"]
            self.events.append(message)
        raise SystemExit(f"{method}: no answer within {PATIENCE} s")

    def close(self):
        self.ask("Browser.close")
        self.process.wait(timeout=PATIENCE)


def said(event):
    """The fault that an event of the browser tells of, or nothing."""
    method, parameters = event.get("method", ""), event.get("params", {})
    if method == "Runtime.consoleAPICalled" and parameters["type"] in ("error", "warning", "assert"):
        return "console: " + " ".join(str(a.get("value", a.get("description"))) for a in parameters["args"])
    if method == "Runtime.exceptionThrown":
        details = parameters["exceptionDetails"]
        return "exception: " + details.get("exception", {}).get("description", details["text"])
    if method == "Log.entryAdded" and parameters["entry"]["level"] in ("error", "warning"):
        return "log: " + parameters["entry"]["text"]
    if method == "Network.requestWillBeSent":
        url = parameters["request"]["url"]
        if not url.startswith("file://") or not url.endswith(".html"):
            return f"request: {url[:100]}"
    return None


def look(browser, page, width, scheme, shots):
    """The faults of a page in one view."""
    target = browser.ask("Target.createTarget", url="about:blank")["targetId"]
    session = browser.ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
    browser.events.clear()
    height = 900 if width > 640 else 844
    for domain in ("Runtime", "Log", "Network", "Page"):
        browser.ask(f"{domain}.enable", session)
    browser.ask("Emulation.setDeviceMetricsOverride", session, width=width, height=height, deviceScaleFactor=1, mobile=width < 640)
    browser.ask("Emulation.setEmulatedMedia", session, features=[{"name": "prefers-color-scheme", "value": scheme}])
    browser.ask("Page.navigate", session, url=page.resolve().as_uri())
    run = lambda code: browser.ask("Runtime.evaluate", session, expression=code, awaitPromise=True, returnByValue=True)["result"].get("value")
    started = time.monotonic()
    while run("document.readyState") != "complete" and time.monotonic() - started < PATIENCE:
        time.sleep(0.05)
    settle = "new Promise((done) => setTimeout(() => requestAnimationFrame(() => done(1)), 150))"
    run(settle)
    faults = list(run(FAULTS) or [])
    if shots:
        name = f"{page.parent.name}-{page.stem}-{width}-{scheme}"
        size = browser.ask("Page.getLayoutMetrics", session)["cssContentSize"]
        whole = {"x": 0, "y": 0, "width": width, "height": size["height"], "scale": 1}
        for ending, more in (("first", {}), ("whole", {"clip": whole, "captureBeyondViewport": True})):
            shot = browser.ask("Page.captureScreenshot", session, format="png", **more)
            (shots / f"{name}-{ending}.png").write_bytes(base64.b64decode(shot["data"]))
    if run(EXERCISE) != "done":
        faults.append("the controls of the page could not be moved")
    run(settle)
    faults += [fault for fault in map(said, browser.events) if fault]
    browser.ask("Target.closeTarget", targetId=target)
    return faults


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pages", nargs="+", type=pathlib.Path, metavar="PAGE.html")
    parser.add_argument("--shots", type=pathlib.Path, metavar="DIR", help="write screenshots there")
    parser.add_argument("--browser", default=os.environ.get("CHROMIUM"), metavar="PATH", help="the browser [default: CHROMIUM, or one on the PATH]")
    arguments = parser.parse_args()
    path = arguments.browser or next(filter(None, map(shutil.which, NAMES)), None)
    if not path:
        print("skipped: no Chromium here (the Debian package is `chromium`)")
        return 0
    if arguments.shots:
        arguments.shots.mkdir(parents=True, exist_ok=True)
    failed = 0
    with tempfile.TemporaryDirectory() as profile:
        try:
            browser = Browser(path, profile)
            browser.ask("Browser.getVersion")
        except (NoBrowser, OSError) as error:
            print(f"skipped: {path} does not start: {error}")
            return 0
        for page in arguments.pages:
            if not page.is_file():
                browser.close()
                parser.error(f"{page}: no such file")
            for width, scheme in VIEWS:
                faults = look(browser, page, width, scheme, arguments.shots)
                failed += bool(faults)
                print(f"{'FAIL' if faults else 'ok  '} {page} {width} px {scheme}")
                for fault in faults:
                    print(f"     {fault}")
        browser.close()
    total = len(arguments.pages) * len(VIEWS)
    print(f"{total - failed} passed, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
