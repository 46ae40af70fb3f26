"""A Hub in 250 lines of the standard library: what huggingface_hub needs to push and pull models and datasets.

    python tests/hub/fake_hub.py            # prints its address, serves until its input is closed

Repositories are kept in memory. Those of the user ``status-404`` (or 401, 403, 503) answer with that status; every
first request for a file of the user ``flaky`` answers 503. ``PUT /put/<models or datasets>/<id>/<path>`` adds a file
to a repository without a client, under any name. Large files are kept once: who sends one again is told that it is
there, as are files of a commit that have not changed. After ``PUT /limit/<n>`` n more large files are taken, and others
answered 403; ``GET /received`` counts the bytes of files that were taken.
"""

import hashlib
import json
import sys
import threading
from base64 import b64decode
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import unquote, urlsplit

LARGE = (".safetensors", ".parquet", ".mp4", ".bin")


class Repository:
    """Commits, each a whole tree, and the names that point to them."""

    def __init__(self):
        self.commits, self.branches, self.tags = {}, {}, {}
        self.commit({})

    def commit(self, files, branch="main"):
        count = len(self.commits)
        sha = hashlib.sha1(f"{count}:{sorted(files)}:{id(self)}".encode()).hexdigest()
        self.commits[sha], self.branches[branch] = files, sha
        return sha

    def sha(self, revision):
        named = self.branches.get(revision) or self.tags.get(revision)
        return named or (revision if revision in self.commits else None)


class Hub(ThreadingHTTPServer):
    """The server and what it keeps."""

    def __init__(self):
        super().__init__(("127.0.0.1", 0), Handler)
        self.repositories, self.blobs, self.asked, self.lock = {}, {}, set(), threading.RLock()
        self.limit, self.received = None, 0

    @property
    def address(self):
        return f"http://127.0.0.1:{self.server_port}"


def git_oid(content):
    return hashlib.sha1(b"blob %d\0" % len(content) + content).hexdigest()


def oid(path, content):
    return hashlib.sha256(content).hexdigest() if path.endswith(LARGE) else git_oid(content)


class Handler(BaseHTTPRequestHandler):
    """Answers one request; the methods below are named by what the request is about."""

    protocol_version = "HTTP/1.1"
    server: Hub

    def log_message(self, *_):
        pass

    def handle_any(self):
        length = int(self.headers.get("Content-Length") or 0)
        self.body = self.rfile.read(length) if length else self._chunks()
        parts = [unquote(part) for part in urlsplit(self.path).path.strip("/").split("/")]
        with self.server.lock:
            if self.command == "PUT":
                self.put(parts)
            elif parts == ["received"]:
                self.answer(200, self.server.received)
            elif parts[:2] == ["api", "repos"]:
                self.create()
            elif parts[:2] == ["api", "validate-yaml"]:
                self.answer(200, {"errors": [], "warnings": []})
            elif parts[0] == "api" and len(parts) >= 4:
                self.api(parts[1], "/".join(parts[2:4]), parts[4:])
            elif ".git/info/lfs" in self.path:
                self.large_files()
            elif "resolve" in parts:
                kind = "datasets" if parts[0] == "datasets" else "models"
                at = parts.index("resolve")
                self.file(kind, "/".join(parts[at - 2 : at]), parts[at + 1], "/".join(parts[at + 2 :]))
            else:
                self.answer(404, {"error": "no such address"})

    do_GET = do_HEAD = do_POST = do_PUT = do_DELETE = handle_any

    def _chunks(self):
        content = b""
        if self.headers.get("Transfer-Encoding") == "chunked":
            while size := int(self.rfile.readline(), 16):
                content += self.rfile.read(size)
                self.rfile.readline()
            self.rfile.readline()
        return content

    def answer(self, status, content=None, **headers):
        body = content if isinstance(content, bytes) else json.dumps({} if content is None else content).encode()
        self.send_response(status)
        for name, value in {"Content-Length": len(body), **headers}.items():
            self.send_header(name.replace("_", "-"), str(value))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def repository(self, kind, name):
        """Looks a repository up; answers by itself, and returns None, where there is none to be had."""
        user = name.split("/")[0]
        if user.startswith("status-"):
            self.answer(int(user.removeprefix("status-")), {"error": "as asked for"})
            return None
        found = self.server.repositories.get((kind, name))
        if found is None:
            self.answer(404, {"error": "Repository not found"}, X_Error_Code="RepoNotFound")
        return found

    def create(self):
        asked = json.loads(self.body)
        name = f"{asked['organization']}/{asked['name']}" if asked.get("organization") else asked["name"]
        if name.startswith("status-"):
            self.answer(int(name.split("/")[0].removeprefix("status-")), {"error": "as asked for"})
            return
        key = (f"{asked.get('type') or 'model'}s", name)
        status = 409 if key in self.server.repositories else 200
        self.server.repositories.setdefault(key, Repository())
        self.answer(status, {"url": self.page(*key), "id": name})

    def page(self, kind, name):
        return f"{self.server.address}/{'' if kind == 'models' else f'{kind}/'}{name}"

    def put(self, parts):
        if parts[0] == "limit":
            self.server.limit = int(parts[1])
        elif parts[0] == "lfs":
            if self.server.limit == 0:
                self.answer(403, {"error": "as asked for"})
                return
            self.server.limit = self.server.limit and self.server.limit - 1
            self.server.blobs[parts[1]] = self.body
            self.server.received += len(self.body)
        else:
            repository = self.server.repositories.setdefault((parts[1], "/".join(parts[2:4])), Repository())
            repository.commit(repository.commits[repository.branches["main"]] | {"/".join(parts[4:]): self.body})
        self.answer(200)

    def large_files(self):
        objects = json.loads(self.body)["objects"]
        for asked in objects:
            if asked["oid"] not in self.server.blobs:
                asked["actions"] = {"upload": {"href": f"{self.server.address}/lfs/{asked['oid']}"}}
        self.answer(200, {"transfer": "basic", "objects": objects})

    def api(self, kind, name, rest):
        repository = self.repository(kind, name)
        if repository is None:
            return
        action = rest[0] if rest else "revision"
        revision = rest[1] if len(rest) > 1 else "main"
        if action == "preupload":
            paths = [asked["path"] for asked in json.loads(self.body)["files"]]
            self.answer(200, {"files": [self.mode(repository, revision, path) for path in paths]})
        elif action == "branch":
            taken = revision in repository.branches
            repository.branches.setdefault(revision, repository.branches["main"])
            self.answer(409 if taken else 200)
        elif action == "commit":
            self.commit(repository, revision, self.page(kind, name))
        elif action == "refs":
            refs = {
                kind: [{"name": n, "ref": f"refs/{kind}/{n}", "targetCommit": sha} for n, sha in named.items()]
                for kind, named in (("branches", repository.branches), ("tags", repository.tags))
            }
            self.answer(200, {**refs, "converts": []})
        elif action == "tag":
            self.tag(repository, revision)
        elif (sha := repository.sha(revision)) is None:
            self.answer(404, {"error": "no such revision"}, X_Error_Code="RevisionNotFound")
        elif action == "tree":
            self.answer(200, [self.entry(path, content) for path, content in repository.commits[sha].items()])
        else:
            siblings = [{"rfilename": path} for path in repository.commits[sha]]
            self.answer(200, {"id": name, "sha": sha, "siblings": siblings, "tags": [], "private": False})

    def mode(self, repository, revision, path):
        content = repository.commits[repository.sha(revision)].get(path)
        mode = {"path": path, "uploadMode": "lfs" if path.endswith(LARGE) else "regular", "shouldIgnore": False}
        return mode if content is None else {**mode, "oid": oid(path, content)}

    def entry(self, path, content):
        entry = {"type": "file", "path": path, "size": len(content), "oid": git_oid(content)}
        if path.endswith(LARGE):
            entry["lfs"] = {"oid": hashlib.sha256(content).hexdigest(), "size": len(content), "pointerSize": 130}
        return entry

    def commit(self, repository, branch, page):
        files = dict(repository.commits[repository.sha(branch)])
        for line in filter(None, self.body.splitlines()):
            change = json.loads(line)
            value = change["value"]
            if change["key"] == "file":
                files[value["path"]] = b64decode(value["content"])
                self.server.received += len(files[value["path"]])
            elif change["key"] == "lfsFile":
                files[value["path"]] = self.server.blobs[value["oid"]]
            elif change["key"] == "deletedFile":
                files.pop(value["path"], None)
            elif change["key"] == "deletedFolder":
                files = {p: c for p, c in files.items() if not p.startswith(value["path"].rstrip("/") + "/")}
        sha = repository.commit(files, branch)
        self.answer(200, {"success": True, "commitOid": sha, "commitUrl": f"{page}/commit/{sha}"})

    def tag(self, repository, name):
        if self.command == "DELETE":
            gone = repository.tags.pop(name, None) is None
            self.answer(404 if gone else 200, **({"X_Error_Code": "RevisionNotFound"} if gone else {}))
        else:
            repository.tags[json.loads(self.body)["tag"]] = repository.sha(name)
            self.answer(200)

    def file(self, kind, name, revision, path):
        repository = self.repository(kind, name)
        if repository is None:
            return
        if name.startswith("flaky/") and self.command == "GET" and path not in self.server.asked:
            self.server.asked.add(path)
            self.answer(503)
            return
        sha = repository.sha(revision)
        content = repository.commits.get(sha, {}).get(path)
        if content is None:
            code = "EntryNotFound" if sha else "RevisionNotFound"
            self.answer(404, {"error": code}, X_Error_Code=code)
            return
        self.answer(200, content, ETag=f'"{oid(path, content)}"', X_Repo_Commit=sha, Accept_Ranges="bytes")


if __name__ == "__main__":
    hub = Hub()
    threading.Thread(target=hub.serve_forever, daemon=True).start()
    sys.stdout.write(f"{hub.address}\n")
    sys.stdout.flush()
    sys.stdin.read()
