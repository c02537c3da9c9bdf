"""A light of one colour, judged by that colour whatever its alpha: *Fire* in the FAME paper has red with alpha 0."""

from __future__ import annotations

import math
from collections.abc import Mapping

from fame.middleware.interface import Message, Node

COLOURS: Mapping[tuple[bool, bool, bool], str] = {
    (False, False, False): "off",
    (True, False, False): "red",
    (False, True, False): "green",
    (False, False, True): "blue",
    (True, True, False): "yellow",
    (False, True, True): "cyan",
    (True, False, True): "magenta",
    (True, True, True): "white",
}
"""Names by which of red, green and blue shine."""


class Led:
    """Obeys `led` (std_msgs/msg/ColorRGBA). `rgb` is 0 to 1 each."""

    def __init__(self, node: Node) -> None:
        self.rgb = (0.0, 0.0, 0.0)
        node.subscription("led", "std_msgs/msg/ColorRGBA", self._light)

    def _light(self, colour: Message) -> None:
        r, g, b = (min(max(float(c), 0.0), 1.0) if math.isfinite(c) else 0.0 for c in (colour.r, colour.g, colour.b))
        self.rgb = (r, g, b)

    @property
    def colour(self) -> str:
        """The name of the colour: a part shines if it has at least half the brightness of the strongest."""
        r, g, b = self.rgb
        half = max(r, g, b) / 2
        return COLOURS[r > 0 and r >= half, g > 0 and g >= half, b > 0 and b >= half]
