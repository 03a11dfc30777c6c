"""Serves the shop's admin on loopback until Ctrl-C: python examples/django_admin/serve.py [PORT]"""

from __future__ import annotations

import os
import shutil
import signal
import sys
from pathlib import Path
from socketserver import ThreadingMixIn
from types import FrameType
from typing import Never
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

PORT = 8010  # as in tasks/*.toml


class Server(ThreadingMixIn, WSGIServer):
    """One thread for each connection."""

    daemon_threads = True
    request_queue_size = 128


class Handler(WSGIRequestHandler):
    """Answers without a line in the log."""

    def log_message(self, format: str, *args: object) -> None:
        """Nothing."""


def stop(number: int, frame: FrameType | None) -> Never:
    """End like Ctrl-C does."""
    raise KeyboardInterrupt


def main() -> None:
    """Fill the template database and serve."""
    sys.path.insert(0, str(Path(__file__).parent.parent.parent))
    os.environ["DJANGO_SETTINGS_MODULE"] = "examples.django_admin.shop.settings"
    signal.signal(signal.SIGTERM, stop)
    import django
    from django.conf import settings
    from django.contrib.staticfiles.handlers import StaticFilesHandler
    from django.core.wsgi import get_wsgi_application

    django.setup()
    try:
        from examples.django_admin.shop.fill import fill

        fill()
        port = int(sys.argv[1]) if len(sys.argv) > 1 else PORT
        application = StaticFilesHandler(get_wsgi_application())
        with make_server("127.0.0.1", port, application, server_class=Server, handler_class=Handler) as server:
            sys.stdout.write(f"http://127.0.0.1:{server.server_port}/admin/\n")
            sys.stdout.flush()
            server.serve_forever()
    except KeyboardInterrupt:
        pass
    finally:
        shutil.rmtree(settings.FOLDER, ignore_errors=True)


if __name__ == "__main__":
    main()
