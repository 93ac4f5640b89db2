"""An object store on this machine, for tests: moto's S3 behind a layer that counts and refuses."""

import os
import socket
import threading
from datetime import timedelta

ENVIRONMENT = {
    "AWS_ACCESS_KEY_ID": "key",
    "AWS_SECRET_ACCESS_KEY": "secret",
    "AWS_REGION": "us-east-1",
    "AWS_EC2_METADATA_DISABLED": "true",
    "AWS_MAX_ATTEMPTS": "3",
}

DENIED = (
    b'<?xml version="1.0" encoding="UTF-8"?><Error><Code>AccessDenied</Code>'
    b"<Message>Access Denied</Message></Error>"
)

RESET = "000 Reset"
"""A status for which the connection is dropped."""


class StoreServer:
    """S3 on loopback, at `address`.

    `sent` is the bytes of all answers so far, after `drop_after` of which connections are dropped,
    and `requests` holds method and path of all requests. `before` is called with both before each
    is answered; the status that it returns, such as "503 Slow Down", is the answer.
    """

    def __init__(self):
        """Start it."""
        from moto.moto_server.werkzeug_app import DomainDispatcherApplication, create_backend_app
        from werkzeug.serving import make_server

        self._application = DomainDispatcherApplication(create_backend_app)
        self.sent, self.requests, self.drop_after = 0, [], None
        self.before = lambda _method, _path: None
        self._server = make_server("127.0.0.1", 0, self._answer, threaded=True)
        self._server.log_startup = lambda: None
        threading.Thread(target=self._server.serve_forever, daemon=True).start()
        self.address = f"http://127.0.0.1:{self._server.server_port}"
        os.environ.update(ENVIRONMENT, AWS_ENDPOINT_URL=self.address)

    def bucket(self, name):
        """Make a bucket; those whose names begin with "denied" refuse everything."""
        from pyarrow.fs import S3FileSystem

        place = self.address.removeprefix("http://")
        # By default it waits for 3 s, in which a busy machine may not even import what answers.
        store = S3FileSystem(
            endpoint_override=place, scheme="http", allow_bucket_creation=True,
            connect_timeout=60, request_timeout=60,
        )  # fmt: skip
        store.create_dir(name)
        return f"s3://{name}"

    def age(self, address):
        """Let all objects of a bucket be an hour older."""
        from moto.backends import get_backend

        for account in get_backend("s3").values():
            found = account["aws"].buckets.get(address.removeprefix("s3://"))
            for key in found.keys.values() if found else ():
                key.last_modified -= timedelta(hours=1)

    def _answer(self, environment, start_response):
        path = environment["PATH_INFO"]
        self.requests.append((environment["REQUEST_METHOD"], path))
        if path.startswith("/denied"):
            start_response("403 Forbidden", [("Content-Type", "application/xml")])
            return [DENIED]
        if status := self.before(environment["REQUEST_METHOD"], path):
            if status == RESET:
                environment["werkzeug.socket"].shutdown(socket.SHUT_RDWR)
            start_response(status, [])
            return []
        answer = list(self._application(environment, start_response))
        if environment["REQUEST_METHOD"] == "GET":
            self.sent += sum(map(len, answer))
        if self.drop_after is not None and self.sent > self.drop_after:
            environment["werkzeug.socket"].shutdown(socket.SHUT_RDWR)
        return answer

    def stop(self):
        """Stop it."""
        self._server.shutdown()
        self._server.server_close()
