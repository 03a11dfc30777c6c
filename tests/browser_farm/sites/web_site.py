"""A small real web server for the tests: forms, dialogs, frames, shadow roots, storage, a service worker."""

from __future__ import annotations

import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, urlsplit

HEAD = "<!DOCTYPE html><html><head><meta charset=utf-8><title>t</title></head><body>"

PAGES = {
    "/form": """<h1>New order</h1><form action=/saved method=post>
        <label for=name>Customer</label> <input id=name name=name>
        <label>Amount <input type=number name=amount></label>
        <label for=day>Day</label> <input type=date id=day name=day>
        <select name=colour><option>red</option><option>green</option><option>blue</option></select>
        <label><input type=checkbox name=gift value=yes> Gift</label>
        <textarea name=note aria-label=Note></textarea>
        <div contenteditable=true aria-label=Remark></div>
        <input type=file name=file aria-label=Invoice>
        <button>Save</button></form><a href=/other target=_blank>Other</a>
        <script>document.querySelector('[contenteditable]').addEventListener('input',
          (e) => { document.querySelector('[name=note]').value = e.target.innerText; });</script>""",
    "/other": "<h1>Other page</h1><a href=/form>Back</a>",
    "/popup": "<button onclick=\"window.open('/other', 'x', 'width=100')\">Open</button>",
    "/dialogs": """<p id=out>nothing</p>
        <button onclick="alert('Careful!'); out.textContent='alerted'">Alert</button>
        <button onclick="out.textContent = confirm('Delete it?') ? 'deleted' : 'kept'">Delete</button>
        <button onclick="out.textContent = 'Name ' + prompt('Your name?', 'Ada')">Ask</button>""",
    "/frames": "<h1>Outside</h1><iframe src=/inside width=300 height=100 style='margin: 40px'></iframe>",
    "/inside": "<button onclick=\"this.textContent = 'Pressed'\">Inside</button>",
    "/shadow": """<my-card></my-card><script>customElements.define('my-card', class extends HTMLElement {
        connectedCallback() { this.attachShadow({mode: 'open'}).innerHTML = `<p>In the shadow</p>
          <input aria-label=Deep><button onclick="this.textContent = 'Pressed'">Shade</button>`; } });</script>""",
    "/slow": """<button onclick="fetch('/wait').then((r) => r.text()).then((t) => { out.textContent = t; })">Load
        </button>
        <button onclick="setTimeout(() => { out.textContent = 'late'; }, 60)">Later</button><p id=out>empty</p>""",
    "/restless": "<p id=clock>0</p><script>setInterval(() => { clock.textContent = Date.now(); }, 20)</script>",
    "/poll": "<p>Polls</p><script>fetch('/never')</script>",
    "/many": "<h1>Many</h1>" + "".join(f"<p><a href=/other?{n}>Link {n}</a></p>" for n in range(500)),
    "/covered": """<div style='position: fixed; top: 0; height: 80px; width: 100%; background: white'>Header</div>
        <div style='height: 3000px'>Space</div><button onclick="this.textContent = 'Pressed'">Deep below</button>
        <div style='height: 2000px'></div>""",
    "/hidden": """<p>Seen</p><p style='display: none'>Gone</p><p style='visibility: hidden'>Invisible</p>
        <p style='position: absolute; left: -9999px'>Away</p><p style='opacity: 0'>Clear</p><div inert>Inert</div>
        <div style='height: 20px; overflow: hidden'><div style='height: 100px'></div><p>Cut off</p></div>""",
    "/modal": """<button>Behind</button><dialog id=d><p>In front</p><button>Yes</button></dialog>
        <script>d.showModal()</script>""",
    "/loop": "<button onclick='for (;;) {}'>Loop</button>",
    "/foreign": """<p id=out>asking</p><a href=http://foreign.test/>Leave</a>
        <iframe src=http://foreign.test/frame></iframe><img src=http://foreign.test/image.png>
        <script>navigator.sendBeacon('http://foreign.test/beacon');
          fetch('http://foreign.test/fetch', {mode: 'no-cors'}).then(() => 'reached', () => 'refused')
          .then((t) => fetch('http://127.0.0.1:4319/port', {mode: 'no-cors'}).then(() => 'reached', () => t))
          .then((t) => { out.textContent = t; })</script>""",
    "/store": """<p id=out>?</p><script>(async () => {
        const seen = [document.cookie, localStorage.getItem('k'), sessionStorage.getItem('k'), window.name];
        const open = () => new Promise((resolve) => { const r = indexedDB.open('db', 1);
          r.onupgradeneeded = () => r.result.createObjectStore('s'); r.onsuccess = () => resolve(r.result); });
        const db = await open(), get = (request) => new Promise((resolve) => {
          request.onsuccess = () => resolve(request.result); });
        seen.push(await get(db.transaction('s').objectStore('s').get('k')));
        seen.push((await caches.keys()).join(), (await navigator.serviceWorker.getRegistrations()).length || '');
        out.textContent = 'seen: ' + seen.filter(Boolean).join('|');
        document.cookie = 'k=cookie'; localStorage.setItem('k', 'local'); sessionStorage.setItem('k', 'session');
        window.name = 'named'; await caches.open('cached');
        await get(db.transaction('s', 'readwrite').objectStore('s').put('indexed', 'k'));
        await navigator.serviceWorker.register('/worker.js'); await navigator.serviceWorker.ready;
        })()</script><a href=/store>Again</a>""",
    "/worker-page": """<p id=out>asking</p><script>navigator.serviceWorker.register('/worker.js');
        navigator.serviceWorker.ready.then(({active}) => { const {port1, port2} = new MessageChannel();
          port1.onmessage = ({data}) => { out.textContent = data; }; active.postMessage('ask', [port2]); })</script>""",
    "/login": "<form action=/enter method=post><input name=user aria-label=User><button>Log in</button></form>",
    "/described": """<input id=who placeholder='Your  name'><img alt='A cat' width=9 height=9 src=data:,>
        <button id=close aria-label='Close it' title=x>X</button><p data-x=1>word</p>
        <nav id=way><a href=/other>Go</a></nav>""",
    "/crash": "<p>Fine</p><a href=/other>Go</a>",
    "/unload": """<script>window.addEventListener('beforeunload', (e) => e.preventDefault())</script>
        <a href=/other>Go</a>""",
    "/local": "<p id=out></p><script>out.textContent = 'token ' + localStorage.getItem('token')</script>",
}
WORKER = """self.addEventListener('install', () => self.skipWaiting());
self.addEventListener('activate', (event) => event.waitUntil(self.clients.claim()));
self.addEventListener('message', (event) => fetch('http://foreign.test/worker', {mode: 'no-cors'})
  .then(() => 'reached', () => 'refused').then((text) => event.ports[0].postMessage(text)));"""


class Quiet(ThreadingHTTPServer):
    """A server that says nothing when a browser closes a connection."""

    daemon_threads = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Nothing."""


class WebSite:
    """The server. `requests` holds the method and path of each request, `posted` the fields of each form."""

    def __init__(self) -> None:
        self.requests: list[str] = []
        self.posted: list[dict[str, str]] = []
        site = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_GET(self) -> None:
                site.requests.append(f"GET {self.path}")
                path = urlsplit(self.path).path
                if path == "/wait":
                    time.sleep(0.3)
                    self.reply("loaded")
                elif path == "/never":
                    time.sleep(5)
                    self.reply("at last")
                elif path == "/worker.js":
                    self.reply(WORKER, kind="text/javascript")
                elif path == "/away":
                    self.reply("", status=302, headers={"Location": "http://foreign.test/"})
                elif path == "/private":
                    known = "user=" in (self.headers["Cookie"] or "")
                    if known:
                        self.reply(f"{HEAD}<p>Welcome {(self.headers['Cookie'] or '').split('user=')[1]}</p>")
                    else:
                        self.reply("", status=302, headers={"Location": "/login"})
                elif path in PAGES:
                    self.reply(HEAD + PAGES[path])
                else:
                    self.reply("none", status=404)

            def do_POST(self) -> None:
                site.requests.append(f"POST {self.path}")
                body = self.rfile.read(int(self.headers["Content-Length"] or 0)).decode()
                fields = {key: values[0] for key, values in parse_qs(body).items()}
                site.posted.append(fields)
                if self.path == "/enter":
                    headers = {"Location": "/private", "Set-Cookie": f"user={fields.get('user', '')}; HttpOnly"}
                    self.reply("", status=303, headers=headers)
                elif self.path.startswith("/check"):
                    self.reply("", status=200 if "ok" in self.path else 409)
                else:
                    self.reply(HEAD + "<h1 class=saved>Saved</h1>")

            def reply(
                self, text: str, *, status: int = 200, kind: str = "text/html", headers: dict[str, str] | None = None
            ) -> None:
                data = text.encode()
                self.send_response(status)
                for name, value in {"Content-Type": kind, "Content-Length": str(len(data)), **(headers or {})}.items():
                    self.send_header(name, value)
                self.end_headers()
                self.wfile.write(data)

            def log_message(self, format: str, *args: Any) -> None:
                """Nothing."""

        self._server = Quiet(("127.0.0.1", 0), Handler)
        threading.Thread(target=self._server.serve_forever, daemon=True).start()
        self.origin = f"http://127.0.0.1:{self._server.server_port}"

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()
