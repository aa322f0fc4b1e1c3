"""An S3 server in this process (moto), for tests of object stores."""

from __future__ import annotations

import contextlib
import logging
import os
from collections.abc import Iterator
from typing import Any
from unittest import mock

KEYS = {"AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test", "AWS_DEFAULT_REGION": "us-east-1"}


@contextlib.contextmanager
def bucket(name: str) -> Iterator[str]:
    """Yield the URL of a bucket. The environment leads pyarrow to its server, in child processes, too."""
    import boto3
    from moto.server import ThreadedMotoServer

    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server: Any = ThreadedMotoServer("127.0.0.1", port=0, verbose=False)
    server.start()
    try:
        endpoint = "http://{}:{}".format(*server.get_host_and_port())
        with mock.patch.dict(os.environ, {**KEYS, "AWS_ENDPOINT_URL": endpoint}):
            boto3.client("s3", endpoint_url=endpoint).create_bucket(Bucket=name)
            yield f"s3://{name}"
    finally:
        server.stop()
