from _shared.block import Block

__all__ = ["MatchedController"]


class MatchedController(Block):
    """The adaptive controller of the matched case."""

    # The wrapper drops a reference to this module's globals with every instance that it makes;
    # this function, made anew each time, holds one. Without it the host crashes.
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
