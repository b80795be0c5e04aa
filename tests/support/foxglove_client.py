"""A client of Foxglove's websocket protocol: subscribes to a topic and returns its first message."""

import json
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

MESSAGE_HEAD = 13
"""Bytes before a message's data: operation, subscription, time (ws-protocol of Foxglove, "Message Data")."""


async def first_message(
    address: str, topic: str, subscribed: Callable[[], Awaitable[None]] | None = None
) -> Any:
    """Return the first JSON message of a topic. subscribed: awaited once the subscription is sent."""
    websocket = pytest.importorskip("tornado.websocket")
    from tornado.httpclient import HTTPRequest

    request = HTTPRequest(address, headers={"Sec-WebSocket-Protocol": "foxglove.sdk.v1"})
    client = await websocket.websocket_connect(request, subprotocols=["foxglove.sdk.v1"])
    while True:
        data = await client.read_message()
        if isinstance(data, bytes):
            client.close()
            while await client.read_message() is not None:
                pass
            return json.loads(data[MESSAGE_HEAD:])
        for channel in json.loads(data).get("channels", ()):
            if channel["topic"] == topic:
                wanted = {"op": "subscribe", "subscriptions": [{"id": 1, "channelId": channel["id"]}]}
                await client.write_message(json.dumps(wanted))
                if subscribed is not None:
                    await subscribed()
