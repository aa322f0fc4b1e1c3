"""A stand-in for the Hub of Hugging Face: the requests that copying a dataset makes, with files in memory.

The client is the real ``huggingface_hub``. The stand-in takes every file as a regular one. The Hub itself stores
large files in another way (Xet), which this does not show.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import json
import logging
import threading
from collections.abc import Iterator

from flask import Flask, Response, jsonify, request
from werkzeug.serving import make_server


class Hub:
    """The datasets of the stand-in: ``commits`` has the summary of each commit, ``files`` the newest files."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        self.commits: list[str] = []
        self.private: list[bool] = []
        self.fails = 0  # So many of the next commits are answered with an error.
        self.app = Flask("hub")
        self.app.add_url_rule("/api/repos/create", view_func=self._create, methods=["POST"])
        self.app.add_url_rule("/api/datasets/<user>/<name>", view_func=self._about)
        self.app.add_url_rule("/api/datasets/<user>/<name>/revision/<revision>", view_func=self._about)
        self.app.add_url_rule("/api/datasets/<user>/<name>/tree/<revision>", view_func=self._tree)
        self.app.add_url_rule("/api/datasets/<user>/<name>/paths-info/<r>", view_func=self._paths, methods=["POST"])
        self.app.add_url_rule("/api/datasets/<user>/<name>/preupload/<r>", view_func=self._modes, methods=["POST"])
        self.app.add_url_rule("/api/datasets/<user>/<name>/commit/<r>", view_func=self._commit, methods=["POST"])
        self.app.add_url_rule("/datasets/<user>/<name>/resolve/<revision>/<path:path>", view_func=self._file)

    def _create(self) -> Response:
        wanted = request.json or {}  # The client's versions say it in one of two ways.
        self.private.append(wanted.get("private") is True or wanted.get("visibility") == "private")
        return jsonify(url=f"{request.host_url}datasets/me/pick", name="me/pick", id="me/pick")

    def _about(self, **_: str) -> Response:
        return jsonify(id="me/pick", sha="0" * 40, private=True, siblings=[])

    def _tree(self, **_: str) -> Response:
        return jsonify([self._entry(path) for path in sorted(self.files)])

    def _paths(self, **_: str) -> Response:
        wanted = request.json["paths"] if request.is_json and request.json else request.form.getlist("paths")
        return jsonify([self._entry(path) for path in wanted if path in self.files])

    def _entry(self, path: str) -> dict[str, object]:
        data = self.files[path]
        return {"type": "file", "path": path, "size": len(data), "oid": hashlib.sha1(data).hexdigest()}

    def _modes(self, **_: str) -> Response:
        files = (request.json or {})["files"]
        modes = [{"path": each["path"], "uploadMode": "regular", "shouldIgnore": False} for each in files]
        return jsonify(files=modes)

    def _commit(self, **_: str) -> Response:
        if self.fails:
            self.fails -= 1
            return Response("no space", status=507)
        for line in request.get_data().splitlines():
            entry = json.loads(line)
            value = entry["value"]
            if entry["key"] == "header":
                self.commits.append(value["summary"])
            else:
                self.files[value["path"]] = base64.b64decode(value["content"])
        return jsonify(
            commitUrl=f"{request.host_url}datasets/me/pick/commit/{'0' * 40}",
            commitOid="0" * 40,
            pullRequestUrl=None,
        )

    def _file(self, path: str, **_: str) -> Response:
        if path not in self.files:
            return Response(status=404, headers={"X-Error-Code": "EntryNotFound"})
        data = self.files[path]
        headers = {
            "ETag": f'"{hashlib.sha1(data).hexdigest()}"',
            "X-Repo-Commit": "0" * 40,
            "Accept-Ranges": "bytes",
        }
        if request.range and request.range.ranges:
            begin, end = request.range.ranges[0]
            part = data[begin or 0 : end]
            headers["Content-Range"] = f"bytes {begin}-{(begin or 0) + len(part) - 1}/{len(data)}"
            return Response(part, status=206, headers=headers)
        return Response(data, headers=headers)


@contextlib.contextmanager
def serving(hub: Hub) -> Iterator[str]:
    """Serve the stand-in, and yield its address."""
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = make_server("127.0.0.1", 0, hub.app, threaded=True)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
