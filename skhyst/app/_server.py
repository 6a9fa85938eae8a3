"""The server of the page: settings for which Streamlit has no option.

A foreign page whose host name is made to resolve to this machine (DNS rebinding) sends that name as
the host, and is refused. No other page may frame this one, which may load nothing from elsewhere.
Streamlit and its charts need inline scripts and code evaluated from text.
"""

from pathlib import Path

from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from streamlit.starlette import App

HOSTS = ("127.0.0.1", "localhost")
POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; "
    "frame-src 'self' data: blob:; worker-src 'self' blob:; object-src 'none'; base-uri 'self'; "
    "form-action 'none'; frame-ancestors 'self'"
)
_HEADERS = ((b"content-security-policy", POLICY.encode()), (b"x-frame-options", b"SAMEORIGIN"))


class _Policy:
    """Adds the policy to every answer."""

    def __init__(self, app):
        self.app = app

    async def __call__(self, scope, receive, send):
        async def with_policy(message):
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", ()), *_HEADERS]
            await send(message)

        await self.app(scope, receive, with_policy)


app = App(
    Path(__file__).with_name("_page.py"),
    middleware=[
        Middleware(_Policy),
        Middleware(TrustedHostMiddleware, allowed_hosts=HOSTS, www_redirect=False),
    ],
)
