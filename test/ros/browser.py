"""A person at the teaching page: a headless Chromium that clicks, drags and looks."""

from __future__ import annotations

import base64
import os
import re
import shutil
import time
from pathlib import Path

import numpy as np
import pytest

from unifeed_ros.console.scene import CAMERA, FIELD_OF_VIEW, LOOK_AT

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
FLAGS = ("--headless", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-quic",
         "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync",
         "--disable-dev-shm-usage", "--force-device-scale-factor=1",
         "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1")
PATIENCE_S = 90.0
"""Longest wait for one thing to happen in the page, where the browser draws without a graphics card [s]."""
FIND_BUTTON = ("const button = [...document.querySelectorAll('button')].find(b => b.getClientRects().length > 0 && "
               "b.innerText.replace(/\\s+/g, ' ').includes(arguments[0])); ")
"""Only what is visible: the page of viser has hidden buttons of its own, among them one to save the picture."""
TRIES = 5
"""How often a step of the lesson is tried."""
STOPS = 6
"""Stops of the arm in a whole lesson after which the machine is taken to be too slow for it."""


def require_browser():
    """Skip the test where no browser can be driven."""
    pytest.importorskip("selenium", reason="no selenium: pip install -r requirements-dev.txt")
    if CHROMIUM is None or DRIVER is None:
        pytest.skip("no browser: apt install chromium chromium-driver")


def open_browser(profile, size=(1280, 943)):
    """Start a browser; its own bars take 143 px of the height, which leaves 800 for the page."""
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    options.page_load_strategy = "none"
    for flag in (*FLAGS, f"--user-data-dir={profile}", f"--window-size={size[0]},{size[1]}"):
        options.add_argument(flag)
    calm = {"preexec_fn": lambda: os.nice(19)}  # the arm needs the processor more than its picture
    browser = webdriver.Chrome(options=options, service=Service(DRIVER, popen_kw=calm))
    browser.set_script_timeout(PATIENCE_S)
    return browser


class Visitor:
    """Somebody at the page, who sees words and buttons.

    Pictures of what they see go to the folder of the environment variable UNIFEED_SCREENSHOTS, if it is set.
    """

    def __init__(self, browser):
        self.browser = browser
        folder = os.environ.get("UNIFEED_SCREENSHOTS")
        self._pictures = Path(folder) if folder else None
        self._taken = 0
        self.stops = []
        """What the page said after each stop of the arm."""

    def look(self, name):
        if self._pictures is not None:
            self._pictures.mkdir(parents=True, exist_ok=True)
            self._taken += 1
            # not save_screenshot: it gives up after 10 s, and drawing without a graphics card may take longer
            picture = self.browser.execute_cdp_cmd("Page.captureScreenshot", {"format": "png"})["data"]
            (self._pictures / f"{self._taken:02d}-{name}.png").write_bytes(base64.b64decode(picture))

    def wait(self, happened, what):
        end = time.monotonic() + PATIENCE_S
        while not happened():
            if time.monotonic() > end:
                self.look("failed")
                pytest.fail(f"{what} did not happen within {PATIENCE_S} s; the page says {self.request()!r}")
            time.sleep(0.1)

    def open(self, address):
        began, self._address = time.monotonic(), address
        self.browser.get(address)
        self.wait(lambda: self.words("who"), "the page")
        return time.monotonic() - began

    def words(self, name):
        script = "const e = document.getElementById(arguments[0]); return e ? e.innerText.trim() : ''"
        return self.browser.execute_script(script, name)

    def request(self):
        return self.words("request")

    def reads(self, text):
        return text in self.browser.execute_script("return document.body.innerText")

    def find(self, pattern):
        """Give what the first group of a pattern matches of all that can be read."""
        return re.search(pattern, self.browser.execute_script("return document.body.innerText"))[1]

    def button(self, text):
        return self.browser.execute_script(FIND_BUTTON + "return button", text)

    def can_press(self, text):
        button = self.button(text)
        return button is not None and button.is_enabled()

    def get_ready(self):
        """Wait until the robot is ready; after a stop note why, and go back to the start, as the page asks for."""
        def ready():
            if "Back to start" in (said := self.request()) and self.can_press("Back to start"):
                self.stops.append(said)
                print(f"{time.strftime('%H:%M:%S')} {said}", flush=True)
                if len(self.stops) > STOPS:
                    self.look("failed")
                    pytest.fail(f"the arm was stopped again and again: {self.stops}")
                self.press("Back to start")
                self.wait(lambda: self.request() != said, "an answer to Back to start")
            return self.can_press("Show a motion")

        self.wait(ready, "ready")

    def has_done(self, step):
        """Say whether a step of the first lesson is ticked off."""
        return self.reads(f"\u2611 {step}.")

    def teach(self, step, act):
        """Do what a step of the first lesson asks for; again, from the first view, where it did not succeed."""
        for _ in range(TRIES):
            act()
            self.get_ready()
            if self.has_done(step):
                return
            self.look("again")
            self.open(self._address)
            self.get_ready()
        pytest.fail(f"step {step} was not done in {TRIES} tries; stops: {self.stops}")

    def wait_or_stop(self, happened, what):
        """Wait until something happens; false if the page asks to go back to the start instead."""
        seen = []
        self.wait(lambda: seen.append(happened()) or seen[-1] or "Back to start" in self.request(), what)
        return seen[-1]

    def press(self, text):
        """Press a button as soon as it can be pressed; found and clicked at once, as the page may draw it anew."""
        script = (FIND_BUTTON + "if (!button || button.disabled || button.dataset.disabled) return false; "
                  "button.click(); return true")
        self.wait(lambda: self.browser.execute_script(script, text), f"button {text!r}")

    def open_tab(self, text):
        script = "return [...document.querySelectorAll('[role=tab]')].find(b => b.innerText.includes(arguments[0]))"
        self.browser.execute_script(script, text).click()  # with the mouse: tabs can be dragged

    def grab(self, place):
        """Press the mouse on a place, shape (3,) [m], and keep it pressed."""
        actions = self._mouse()
        self._move(actions, self.project(place))
        actions.pause(1.0).w3c_actions.pointer_action.pointer_down()
        actions.pause(0.3)
        actions.perform()

    def drag(self, places, seen):
        """Move the pressed mouse through places, shape (N, 3) [m], take a picture of that name, and let go."""
        actions = self._mouse()
        for pixels in self.project(places):
            self._move(actions, pixels[None])
            actions.pause(0.05)
        actions.perform()
        self.look(seen)
        actions = self._mouse()
        actions.pause(0.3)
        actions.w3c_actions.pointer_action.pointer_up()
        actions.perform()

    def _mouse(self):
        from selenium.webdriver.common.action_chains import ActionChains

        return ActionChains(self.browser, duration=60)

    def _move(self, actions, pixels):
        x, y = np.rint(pixels[0]).astype(int)
        actions.w3c_actions.pointer_action.move_to_location(int(x), int(y))

    def project(self, places):
        """Find the pixels of places in the first view, shape (N, 3) [m]."""
        rect = self.browser.execute_script(
            "const r = [...document.querySelectorAll('canvas')].map(c => c.getBoundingClientRect())"
            ".sort((a, b) => b.width * b.height - a.width * a.height)[0]; return [r.x, r.y, r.width, r.height]")
        x, y, width, height = rect
        forward = np.subtract(LOOK_AT, CAMERA)
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        away = np.atleast_2d(places) - CAMERA
        scale = 0.5 * height / np.tan(0.5 * FIELD_OF_VIEW) / (away @ forward)
        return np.stack([x + 0.5 * width + scale * (away @ right),
                         y + 0.5 * height - scale * (away @ np.cross(right, forward))], axis=1)
