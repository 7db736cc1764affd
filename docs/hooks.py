"""What `make docs` checks beyond MkDocs' own warnings: no page loads anything from another host."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError

OTHER_HOST = re.compile(r"^\s*(?:https?:)?//", re.IGNORECASE)
"""How an address on another host begins."""

STYLE_ADDRESS = re.compile(
    r"""(?:url\(|@import)\s*["']?\s*((?:https?:)?//[^"')\s]+)""", re.IGNORECASE
)
"""An address that a style sheet loads."""

LOADING_ATTRIBUTES = ("src", "srcset", "poster", "data")
"""Attributes whose address a browser loads by itself, whatever the element."""


class _Resources(HTMLParser):
    """Collects the addresses that a browser loads by itself; links the reader clicks are none of them."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        names = LOADING_ATTRIBUTES
        if tag in ("link", "image", "use"):
            names = (*names, "href", "xlink:href")
        for name, address in attrs:
            if name in names and address:
                self.addresses.append(address)


def on_post_build(config: MkDocsConfig) -> None:
    """Refuse a site that could not be read without a network."""
    site = Path(config.site_dir)
    complaints: list[str] = []
    for page in sorted(site.rglob("*.html")):
        text = page.read_text(encoding="utf-8")
        resources = _Resources()
        resources.feed(text)
        foreign = [address for address in resources.addresses if OTHER_HOST.match(address)]
        foreign += STYLE_ADDRESS.findall(text)
        complaints += [f"{page.relative_to(site)} loads {address}" for address in foreign]
    for sheet in sorted(site.rglob("*.css")):
        foreign = STYLE_ADDRESS.findall(sheet.read_text(encoding="utf-8"))
        complaints += [f"{sheet.relative_to(site)} loads {address}" for address in foreign]
    if complaints:
        raise PluginError("Pages must be readable offline: " + "; ".join(complaints))
