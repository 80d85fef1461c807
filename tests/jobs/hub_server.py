"""A local server with the endpoints of the Hugging Face Hub that publishing and fetching use."""

import base64
import contextlib
import hashlib
import json
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import unquote, urlsplit

COMMIT = "0123456789abcdef0123456789abcdef01234567"


class _Handler(BaseHTTPRequestHandler):
    def log_message(self, *_):
        pass

    def _answer(self, value, status=200, headers=()):
        body = value if isinstance(value, bytes) else json.dumps(value).encode()
        self.send_response(status)
        for name, text in (("Content-Length", str(len(body))), *headers):
            self.send_header(name, text)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def do_POST(self):
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        path, files = urlsplit(self.path).path, self.server.files
        if path == "/api/repos/create":
            self.server.created.append(json.loads(body))
            self._answer({"url": f"{self.server.address}/me/mine", "name": "me/mine"})
        elif path == "/api/validate-yaml":
            self._answer({"errors": [], "warnings": []})
        elif "/preupload/" in path:
            asked = json.loads(body)["files"]
            modes = [
                {"path": f["path"], "uploadMode": "regular", "shouldIgnore": False} for f in asked
            ]
            self._answer({"files": modes})
        else:  # a commit: a line of JSON per operation
            for line in body.decode().splitlines():
                operation = json.loads(line)
                if operation["key"] == "file":
                    value = operation["value"]
                    files[value["path"]] = base64.b64decode(value["content"])
            self._answer(
                {
                    "commitUrl": f"{self.server.address}/me/mine",
                    "commitOid": COMMIT,
                    "success": True,
                }
            )

    def do_GET(self):
        path, files = unquote(urlsplit(self.path).path), self.server.files
        if path.startswith("/api/models/me/mine"):
            siblings = [{"rfilename": n, "size": len(c)} for n, c in files.items()]
            self._answer({"id": "me/mine", "sha": COMMIT, "siblings": siblings})
        elif path.rpartition("/")[2] in files and f"/resolve/{COMMIT}/" in path:
            content = files[path.rpartition("/")[2]]
            etag = f'"{hashlib.sha256(content).hexdigest()}"'
            self._answer(content, headers=(("ETag", etag), ("X-Repo-Commit", COMMIT)))
        else:
            self._answer(
                {"error": "Repository not found"}, 404, (("X-Error-Code", "RepoNotFound"),)
            )

    do_HEAD = do_GET


@contextlib.contextmanager
def hub():
    """Run the server; yields it with its address, the files and the created repositories."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), _Handler)
    server.files, server.created = {}, []
    server.address = f"http://127.0.0.1:{server.server_port}"
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()
