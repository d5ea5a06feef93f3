"""Webhooks on a real database, sent to a real HTTP server, by a clock that the test moves."""

from __future__ import annotations

import asyncio
import base64
import hashlib
import hmac
import ipaddress
import json
import socket
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from tests.receiver import Received, Receiver, receiver
from tests.service import wait_until
from tests.unit.adapters.world import World
from wibam_core.adapters import webhook_sending
from wibam_core.adapters.webhook_sending import Refused, WebhookSender, check_url
from wibam_core.adapters.webhook_store import Due, WebhookStore
from wibam_core.errors import Conflict, InputError, NotFound
from wibam_core.jobs.webhooks import BACKOFF_S, USUAL_EVENTS, Attempt, DeliveryState, WebhookEvent

HERE = [ipaddress.ip_network("127.0.0.0/8"), ipaddress.ip_network("::1/128")]


@pytest.fixture
def told() -> Iterator[Receiver]:
    with receiver() as running:
        yield running


@pytest.fixture
def hooks(world: World) -> WebhookStore:
    return WebhookStore(world.database, lambda: world.time)


@pytest.fixture
def sender(hooks: WebhookStore) -> WebhookSender:
    return WebhookSender(hooks, HERE)


def finish(world: World, tag: str = "") -> str:
    """A job that succeeds; returns its id."""
    job = world.job(tag, name="first", tags=["wet"])
    for stage in "abcd":
        world.do(job, stage)
    return job.id


def is_signed(received: Received, secret: str) -> bool:
    """As the specification of Standard Webhooks has it."""
    key = base64.b64decode(secret.partition("_")[2])
    content = f"{received.headers['webhook-id']}.{received.headers['webhook-timestamp']}.".encode() + received.body
    expected = base64.b64encode(hmac.new(key, content, hashlib.sha256).digest()).decode()
    return received.headers["webhook-signature"] == f"v1,{expected}"


def only(hooks: WebhookStore, webhook_id: str) -> Any:
    [delivery] = hooks.deliveries(webhook_id)
    return delivery


class TestWhoIsTold:
    def test_sites_jobs_and_all_of_the_events_that_they_chose(
        self, world: World, hooks: WebhookStore, sender: WebhookSender, told: Receiver
    ) -> None:
        everything, secret = hooks.create(told.url, [*USUAL_EVENTS, WebhookEvent.RUNNING])
        of_site, _ = hooks.create(told.url, USUAL_EVENTS, site_id=world.site.id)
        of_other, _ = hooks.create(told.url, USUAL_EVENTS, site_id=world.sites.add_site(world.site.site).id)
        of_failures, _ = hooks.create(told.url, [WebhookEvent.FAILED])
        resting, _ = hooks.create(told.url, USUAL_EVENTS)
        hooks.change(resting.id, active=False)
        job = finish(world)
        assert [one.event for one in hooks.deliveries(of_site.id)] == [WebhookEvent.SUCCEEDED]
        assert {one.event for one in hooks.deliveries(everything.id)} == {WebhookEvent.RUNNING, WebhookEvent.SUCCEEDED}
        assert hooks.deliveries(of_other.id) == hooks.deliveries(of_failures.id) == hooks.deliveries(resting.id) == []
        assert sender.send_due() == 3
        assert sender.send_due() == 0
        assert sum(is_signed(one, secret) for one in told.got) == 2
        body = json.loads(next(one.body for one in told.got if b"succeeded" in one.body))
        assert body["type"] == "job.succeeded"
        assert body["data"].items() >= {"job_id": job, "name": "first", "tags": ["wet"], "state": "succeeded"}.items()
        assert told.got[0].path == "/told?by=wibam"
        assert told.got[0].headers["host"] == f"127.0.0.1:{told.port}"

    def test_a_webhook_of_a_job_hears_how_it_ends_even_if_the_job_is_deleted_then(
        self, world: World, hooks: WebhookStore, sender: WebhookSender, told: Receiver
    ) -> None:
        job = world.job()
        hook, _ = hooks.create(told.url, USUAL_EVENTS, job_id=job.id)
        world.jobs.cancel(job.id)
        world.jobs.delete(job.id, lambda stage, hash: None)
        hooks.tidy()
        assert sender.send_due() == 1
        assert json.loads(told.got[0].body)["data"]["state"] == "cancelled"
        hooks.tidy()
        with pytest.raises(NotFound):
            hooks.webhook(hook.id)

    def test_why_a_job_failed_is_told(self, world: World, hooks: WebhookStore) -> None:
        hook, _ = hooks.create("https://example.org/x", USUAL_EVENTS)
        job = world.job()
        world.leases.fail(world.claim(job, "a"), InputError("no recording", hint="Send one."))
        [delivery] = hooks.deliveries(hook.id)
        assert json.loads(delivery.body)["data"]["error"]["code"] == "invalid_input"

    def test_what_cannot_be_told_is_refused(self, world: World, hooks: WebhookStore) -> None:
        job = finish(world)
        with pytest.raises(Conflict, match="succeeded already"):
            hooks.create("https://example.org", USUAL_EVENTS, job_id=job)
        with pytest.raises(NotFound):
            hooks.create("https://example.org", USUAL_EVENTS, site_id="site_0")
        with pytest.raises(InputError, match="of a site or of a job"):
            hooks.create("https://example.org", USUAL_EVENTS, site_id=world.site.id, job_id=job)


class TestSlowReceivers:
    def test_they_delay_no_other(self, hooks: WebhookStore, sender: WebhookSender, told: Receiver) -> None:
        """One that lets every request wait, and many of it wait longer than anything for others."""
        goes_on = threading.Event()
        with receiver() as slow:
            slow.before = lambda: goes_on.wait(60.0) and None
            late, _ = hooks.create(slow.url, USUAL_EVENTS)
            for _ in range(40):
                hooks.ping(late.id)
            hook, _ = hooks.create(told.url, USUAL_EVENTS)
            hooks.ping(hook.id)
            sender.start()
            try:
                wait_until(lambda: bool(slow.got))
                for count in range(2, 5):  # what comes while others are on their way is told, too
                    wait_until(lambda: all(one.state is DeliveryState.DELIVERED for one in hooks.deliveries(hook.id)))
                    hooks.ping(hook.id)
                    wait_until(lambda count=count: len(told.got) == count)  # type: ignore[misc]
                assert {one.state for one in hooks.deliveries(late.id)} == {DeliveryState.PENDING}
                assert len(slow.got) < 10
            finally:
                goes_on.set()
                sender.stop()

    def test_who_answers_while_the_database_is_busy_is_heard(self, world: World, told: Receiver) -> None:
        """What is noted of one receiver waits until another, which answers only then, has been heard."""
        begun, other_is_noted = threading.Event(), threading.Event()
        was_heard: list[bool] = []

        class Busy(WebhookStore):
            def note(self, due: Due, attempt: Attempt) -> None:
                if due.delivery.webhook_id == first.id:
                    begun.set()
                    was_heard.append(other_is_noted.wait(10.0))
                super().note(due, attempt)
                if due.delivery.webhook_id == other.id:
                    other_is_noted.set()

        store = Busy(world.database, lambda: world.time)
        with receiver() as later:
            later.before = lambda: begun.wait(60.0) and None
            first, other = (store.create(one.url, USUAL_EVENTS)[0] for one in (told, later))
            for hook in (first, other):
                store.ping(hook.id)
            assert WebhookSender(store, HERE).send_due() == 2
        assert was_heard == [True]
        assert {only(store, hook.id).state for hook in (first, other)} == {DeliveryState.DELIVERED}

    def test_no_more_of_one_webhook_is_taken_at_once_than_asked_for(self, hooks: WebhookStore) -> None:
        first, second = (hooks.create("https://example.org/x", USUAL_EVENTS)[0] for _ in range(2))
        for hook in (first, first, first, second):
            hooks.ping(hook.id)
        assert hooks.take(10, 60.0, most_each=2, busy=[first.id, second.id]) == []
        taken = hooks.take(10, 60.0, most_each=2)
        assert sorted(one.delivery.webhook_id for one in taken) == sorted([first.id, first.id, second.id])
        assert [one.delivery.webhook_id for one in hooks.take(10, 60.0, most_each=2)] == [first.id]
        assert hooks.take(10, 60.0, most_each=2) == []


class TestRetries:
    def test_come_later_and_later_until_it_is_given_up(
        self, world: World, hooks: WebhookStore, sender: WebhookSender, told: Receiver
    ) -> None:
        hook, secret = hooks.create(told.url, USUAL_EVENTS)
        hooks.ping(hook.id)
        told.answers = [(500, "X-None", "-")]
        for wait_s in BACKOFF_S:
            assert sender.send_due() == 1
            world.time += wait_s - 0.5
            assert sender.send_due() == 0
            world.time += 1.0
        assert sender.send_due() == 1
        delivery = only(hooks, hook.id)
        assert (delivery.state, delivery.next_at, len(delivery.attempts)) == (DeliveryState.FAILED, None, 10)
        assert {one.error for one in delivery.attempts} == {"answered with status 500"}
        assert len({one.headers["webhook-id"] for one in told.got}) == 1
        assert all(is_signed(one, secret) for one in told.got)
        told.answers = [(200, "X-None", "-")]
        hooks.send_again(hook.id, delivery.id)
        assert sender.send_due() == 1
        assert only(hooks, hook.id).state is DeliveryState.DELIVERED

    def test_a_sender_that_dies_is_followed_by_another(
        self, world: World, hooks: WebhookStore, sender: WebhookSender, told: Receiver
    ) -> None:
        hook, _ = hooks.create(told.url, USUAL_EVENTS)
        hooks.ping(hook.id)
        [lost] = hooks.take(10, lease_s=60.0)  # and nothing is heard of it any more
        assert sender.send_due() == 0
        world.time += 61.0
        assert sender.send_due() == 1
        delivered = only(hooks, hook.id)
        assert delivered.state is DeliveryState.DELIVERED
        hooks.note(lost, webhook_sending.Attempt(world.time, 500, "late", 1.0))
        assert only(hooks, hook.id) == delivered

    def test_a_receiver_that_is_gone_is_told_nothing_any_more(
        self, hooks: WebhookStore, sender: WebhookSender, told: Receiver
    ) -> None:
        hook, _ = hooks.create(told.url, USUAL_EVENTS)
        hooks.ping(hook.id)
        told.answers = [(410, "X-None", "-")]
        sender.send_due()
        assert not hooks.webhook(hook.id).active
        assert only(hooks, hook.id).state is DeliveryState.FAILED

    def test_who_does_not_answer_or_listen_is_tried_again(
        self, hooks: WebhookStore, sender: WebhookSender, told: Receiver, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(webhook_sending, "_TIMEOUT_S", 0.3)
        answer = threading.Event()
        told.before = lambda: bool(answer.wait(30)) and None
        with socket.create_server(("127.0.0.1", 0)) as unused:
            closed = unused.getsockname()[1]
        silent, _ = hooks.create(told.url, USUAL_EVENTS)
        deaf, _ = hooks.create(f"http://127.0.0.1:{closed}/", USUAL_EVENTS)
        for hook in (silent, deaf):
            hooks.ping(hook.id)
        assert sender.send_due() == 2
        answer.set()
        assert only(hooks, silent.id).attempts[0].error == "no answer within 0.3 s"
        assert only(hooks, deaf.id).attempts[0].status is None
        assert {only(hooks, hook.id).state for hook in (silent, deaf)} == {DeliveryState.PENDING}

    def test_one_that_cannot_be_reached_at_all_holds_no_other_up(
        self, hooks: WebhookStore, sender: WebhookSender, told: Receiver
    ) -> None:
        hopeless, _ = hooks.create(f"http://{'a' * 70}.example/", USUAL_EVENTS)  # no name has so long a part
        well, _ = hooks.create(told.url, USUAL_EVENTS)
        for hook in (hopeless, well):
            hooks.ping(hook.id)
        assert sender.send_due() == 2
        assert only(hooks, well.id).state is DeliveryState.DELIVERED
        assert only(hooks, hopeless.id).attempts[0].error
        assert only(hooks, hopeless.id).state is DeliveryState.PENDING

    def test_names_that_no_server_answers_for_hold_no_other_up(
        self, hooks: WebhookStore, sender: WebhookSender, told: Receiver, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(webhook_sending, "_LOOKUP_S", 1.0)
        over, ended = threading.Event(), threading.Semaphore(0)
        look_up = socket.getaddrinfo

        def silent(host: Any, *rest: Any, **more: Any) -> Any:
            if str(host).endswith(".example"):
                over.wait(600)
                ended.release()
                raise socket.gaierror("no server answers")
            return look_up(host, *rest, **more)

        dead = [hooks.create(f"http://dead{i}.example/", USUAL_EVENTS)[0] for i in range(15)]
        well, _ = hooks.create(told.url, USUAL_EVENTS)
        for hook in (*dead, well):
            hooks.ping(hook.id)
        monkeypatch.setattr(socket, "getaddrinfo", silent)
        assert sender.send_due() == 16
        assert not ended.acquire(blocking=False), "a lookup was waited for to its end"
        over.set()
        for _ in dead:
            assert ended.acquire(timeout=600)
        assert only(hooks, well.id).state is DeliveryState.DELIVERED
        errors = {only(hooks, hook.id).attempts[0].error for hook in dead}
        assert errors == {"its name was not found within 1 s"}
        assert {only(hooks, hook.id).state for hook in dead} == {DeliveryState.PENDING}

    def test_how_long_a_name_is_looked_up_is_not_taken_from_the_answer(
        self, hooks: WebhookStore, sender: WebhookSender, told: Receiver, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        looked_up, timeout = threading.Event(), asyncio.timeout
        look_up = socket.getaddrinfo

        def slow(*asked: Any, **more: Any) -> Any:
            looked_up.set()
            return look_up(*asked, **more)

        limits: list[tuple[float, bool]] = []

        def limited(seconds: float) -> Any:
            limits.append((seconds, looked_up.is_set()))
            return timeout(seconds)

        hooks.ping(hooks.create(told.url, USUAL_EVENTS)[0].id)
        monkeypatch.setattr(socket, "getaddrinfo", slow)
        monkeypatch.setattr(asyncio, "timeout", limited)
        sender.send_due()
        assert limits == [(webhook_sending._LOOKUP_S, False), (webhook_sending._TIMEOUT_S, True)]


class TestAddresses:
    @pytest.mark.parametrize(
        "host",
        ["127.0.0.1", "10.1.2.3", "169.254.169.254", "192.168.0.1", "0.0.0.0", "100.64.0.1", "224.0.0.1",
         "[::1]", "[fe80::1]", "[fd00::1]", "[::ffff:127.0.0.1]", "[64:ff9b::a00:1]", "[2002:7f00:1::]", "[ff02::1]",
         "[fec0::1]", "[feff::1]", "[64:ff9b:1::808:808]", "[::]", "[::2]", "[::10.1.2.3]", "[::169.254.169.254]"],
    )  # fmt: skip
    def test_of_the_operators_own_are_refused(self, host: str) -> None:
        with pytest.raises(Refused):
            check_url(f"http://{host}/x", [])

    @pytest.mark.parametrize("host", ["1.1.1.1", "[2606:4700:4700::1111]", "[::1.1.1.1]", "example.org", "localhost"])
    def test_public_ones_and_names_are_kept(self, host: str) -> None:
        assert check_url(f"https://{host}:8443/x?y=z", []) == f"https://{host}:8443/x?y=z"

    def test_in_a_network_that_the_operator_allows_too(self) -> None:
        assert check_url("http://10.1.2.3/", [ipaddress.ip_network("10.1.0.0/16")])
        assert check_url("http://[::ffff:10.1.2.3]/", [ipaddress.ip_network("10.1.0.0/16")])
        assert check_url("http://[::10.1.2.3]/", [ipaddress.ip_network("10.1.0.0/16")])
        assert check_url("http://[::1]/", [ipaddress.ip_network("::1/128")])
        assert check_url("http://[fec0::1]/", [ipaddress.ip_network("fec0::/10")])
        with pytest.raises(Refused):
            check_url("http://10.2.2.3/", [ipaddress.ip_network("10.1.0.0/16")])

    @pytest.mark.parametrize(
        "url",
        ["", "example.org", "ftp://example.org", "http://", "http://u:p@example.org", "http://u@example.org",
         "http://example.org:99999", "http://exa mple.org", "http://a\nb", "https://" + "x" * 2000, "http://[::1"],
    )  # fmt: skip
    def test_that_are_none_are_refused(self, url: str) -> None:
        with pytest.raises(InputError):
            check_url(url, HERE)

    def test_a_name_that_leads_inside_is_refused_when_it_is_told(self, hooks: WebhookStore, told: Receiver) -> None:
        hook, _ = hooks.create(f"http://localhost:{told.port}/", USUAL_EVENTS)
        hooks.ping(hook.id)
        assert WebhookSender(hooks).send_due() == 1
        assert told.got == []
        assert "is not a public address" in only(hooks, hook.id).attempts[0].error

    def test_a_name_is_looked_up_once_and_the_address_that_was_judged_is_used(
        self, hooks: WebhookStore, sender: WebhookSender, told: Receiver, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        lookups: list[Any] = []
        answers = ["127.0.0.1", "127.0.0.99"]

        def rebinding(host: Any, port: Any, *rest: Any, **more: Any) -> list[Any]:
            lookups.append(host)
            return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (answers[len(lookups) - 1], port))]

        hook, _ = hooks.create(f"http://rebinding.example:{told.port}/x", USUAL_EVENTS)
        hooks.ping(hook.id)
        monkeypatch.setattr(socket, "getaddrinfo", rebinding)
        sender.send_due()
        assert lookups == ["rebinding.example"]
        assert told.got[0].headers["host"] == f"rebinding.example:{told.port}"

    def test_redirects_are_not_followed(self, hooks: WebhookStore, sender: WebhookSender, told: Receiver) -> None:
        hook, _ = hooks.create(told.url, USUAL_EVENTS)
        hooks.ping(hook.id)
        told.answers = [(307, "Location", f"http://127.0.0.1:{told.port}/elsewhere")]
        sender.send_due()
        assert [one.path for one in told.got] == ["/told?by=wibam"]
        assert only(hooks, hook.id).attempts[0].error == "answered with status 307"
