"""Who gets in, who gives commands."""

from __future__ import annotations

import pytest
from websockets.datastructures import Headers

from unifeed_ros.console.access import COOKIE, Gate, Holder, choose_token, is_loopback
from unifeed_ros.core.errors import ConfigError

LOCAL = Headers({"Host": "127.0.0.1:8080"})


def test_only_other_machines_need_a_token():
    assert choose_token("127.0.0.1", "") == "" and choose_token("localhost", "") == ""
    first, second = choose_token("0.0.0.0", ""), choose_token("0.0.0.0", "")
    assert len(first) >= 20 and first != second
    assert choose_token("127.0.0.1", "mine") == "mine" == choose_token("0.0.0.0", "mine")


@pytest.mark.parametrize("host", ["203.0.113.7", "no.such.host.invalid"])
def test_addresses_of_other_machines_are_refused(host):
    with pytest.raises(ConfigError, match="address of the console"):
        is_loopback(host)


@pytest.mark.parametrize("headers", [
    Headers({"Host": "evil.example"}),
    Headers({"Host": "evil.example", "Origin": "http://evil.example"}),
    Headers({"Host": "127.0.0.1:8080", "Origin": "http://evil.example"}),
    Headers({"Host": "127.0.0.1:8080", "Origin": "http://127.0.0.1:9999"}),
    Headers({"Host": "127.0.0.1:8080", "Origin": "null"}),
    Headers({}),
])
def test_other_sites_are_kept_out_of_this_machine(headers):
    assert Gate("", local=True).refusal("/", headers)


@pytest.mark.parametrize("host", ["127.0.0.1:8080", "localhost:8080", "[::1]:8080"])
def test_the_page_itself_gets_in(host):
    assert Gate("", local=True).refusal("/", Headers({"Host": host, "Origin": f"http://{host}"})) == ""


def test_the_token_opens_and_the_cookie_keeps_open():
    gate = Gate("secret", local=False)
    page = Headers({"Host": "robot:8080"})
    assert gate.refusal("/", page) and gate.refusal("/?token=wrong", page) and gate.cookie("/?token=wrong") == ""
    assert gate.refusal("/?token=secret", page) == ""
    cookie = gate.cookie("/?token=secret")
    assert "HttpOnly" in cookie and "SameSite=Strict" in cookie
    kept = Headers({"Host": "robot:8080", "Cookie": cookie.partition(";")[0]})
    assert gate.refusal("/", kept) == ""
    for bad in (f"{COOKIE}=wrong", "other=secret", f"{COOKIE}=", f"{COOKIE}=ä", "=;;="):
        assert gate.refusal("/", Headers({"Host": "robot:8080", "Cookie": bad})), bad


def test_the_first_page_has_control_until_it_closes_or_another_takes_it():
    pages = Holder()
    assert not pages.may(None)
    pages.open(1)
    pages.open(2)
    assert pages.may(1) and not pages.may(2)
    pages.take(2)
    assert pages.may(2) and not pages.may(1)
    pages.take(7)
    assert pages.holder == 2
    pages.close(2)
    assert pages.holder == 1
    pages.close(1)
    assert pages.holder is None and not pages.may(1)
