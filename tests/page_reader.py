"""What a page's script would read."""

import base64
import json
import re

import numpy as np


def player_data(page):
    """The JSON that a page gives to its player, arrays unpacked."""
    text = page.read_text("utf-8")
    (found,) = re.findall(r"const PLAYER = (\{.*\});</script>", text)
    return _unpacked(json.loads(found))


def _unpacked(value):
    if isinstance(value, dict):
        if set(value) == {"type", "data"}:
            data = base64.b64decode(value["data"])
            return np.frombuffer(data, "<" + value["type"])
        return {k: _unpacked(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_unpacked(v) for v in value]
    return value


def clip_titles(page):
    """Titles by group, as the page lists them."""
    text = page.read_text("utf-8")
    groups = re.findall(r'<optgroup label="(.*?)">(.*?)</optgroup>', text)
    return {
        group: re.findall(r"<option[^>]*>(.*?)</option>", options)
        for group, options in groups
    }


def network_addresses(page):
    """Addresses that a browser would fetch when it opens the page."""
    text = page.read_text("utf-8")
    tags = re.findall(r"<(?:script|link|img|iframe)\b[^>]*>", text)
    return [tag for tag in tags if "//" in tag]
