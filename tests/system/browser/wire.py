"""A line between a browser and the service that can be interrupted: a TCP proxy (standard library only)."""

import contextlib
import socket
import threading
from urllib.parse import urlsplit


class Wire:
    """Carries bytes to the service and back. The browser uses the `url` of the wire."""

    def __init__(self, service_url):
        at = urlsplit(service_url)
        self.service = (at.hostname, at.port)
        self.sockets, self.is_cut, self.passes = set(), False, threading.Event()
        self.passes.set()
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self.listener.getsockname()[1]}"
        threading.Thread(target=self.accept, daemon=True).start()

    def cut(self):
        """Closes every connection and every new one, as when the service is killed."""
        self.is_cut = True
        for one in list(self.sockets):
            shut(one)

    def silence(self):
        """Carries nothing and closes nothing, as when the network is gone."""
        self.passes.clear()

    def mend(self):
        """Carries again. What was sent in silence arrives now."""
        self.is_cut = False
        self.passes.set()

    def close(self):
        """Ends the wire."""
        self.cut()
        self.passes.set()
        shut(self.listener)
        self.listener.close()

    def accept(self):
        """Connects each browser to the service."""
        while True:
            try:
                browser, _ = self.listener.accept()
            except OSError:
                return
            # Known to `cut` before it is asked whether the wire is cut: none is missed.
            self.sockets.add(browser)
            try:
                service = None if self.is_cut else socket.create_connection(self.service)
            except OSError:
                service = None
            if service is None:
                self.sockets.discard(browser)
                browser.close()
                continue
            self.sockets.add(service)
            for pair in ((browser, service), (service, browser)):
                threading.Thread(target=self.carry, args=pair, daemon=True).start()

    def carry(self, source, sink):
        """Carries one direction until a side closes."""
        with contextlib.suppress(OSError):
            while not self.is_cut and (data := source.recv(1 << 16)):
                self.passes.wait()
                sink.sendall(data)
        for one in (source, sink):
            self.sockets.discard(one)
            shut(one)
            one.close()


def shut(one):
    """Wakes every thread that waits for a socket."""
    with contextlib.suppress(OSError):
        one.shutdown(socket.SHUT_RDWR)
