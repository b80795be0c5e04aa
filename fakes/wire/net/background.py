"""A socket server in a thread of its own."""

import socketserver
import threading


class BackgroundServer:
    """Serves from `start` to `stop`. poll_s: how soon it notices that it is to stop."""

    def __init__(self, server: socketserver.TCPServer, poll_s: float = 0.1) -> None:
        self._server = server
        self._thread = threading.Thread(target=server.serve_forever, args=(poll_s,), daemon=True)

    @property
    def host_port(self) -> tuple[str, int]:
        """Where it listens."""
        host, port = self._server.server_address[:2]
        return str(host), int(port)

    def start(self) -> None:
        """Begin to answer."""
        self._thread.start()

    def stop(self) -> None:
        """Stop listening. Safe before `start`."""
        if self._thread.is_alive():
            self._server.shutdown()
            self._thread.join()
        self._server.server_close()
