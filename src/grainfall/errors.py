"""The one exception a user meets: one line that says where, what is wrong and what would be right."""

from __future__ import annotations


class InputError(ValueError):
    """A user's mistake in an image, a config or a sample sheet.

    Parameters
    ----------
    where : str
        The file, key or table cell at fault.
    wrong : str
        What is wrong with it.
    right : str
        What would be right.
    """

    def __init__(self, where: object, wrong: str, right: str = ""):
        self.where, self.wrong, self.right = str(where), wrong, right
        line = f"{_short(where)}: {_short(wrong)}" + (f"; {_short(right)}" if right else "")
        # A terminal obeys control characters, and a name may have some in it.
        line = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in " ".join(line.split()))
        super().__init__(line)

    def __reduce__(self):
        return type(self), (self.where, self.wrong, self.right)


def _short(text: object, most: int = 400) -> str:
    """The text without its middle where it is longer than anybody reads."""
    text = str(text)
    return text if len(text) <= most else f"{text[: most // 2]} ... {text[-most // 2 :]}"
