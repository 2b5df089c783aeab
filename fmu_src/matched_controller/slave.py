from _shared.block import Block

__all__ = ["MatchedController"]


class MatchedController(Block):
    """The adaptive controller of the matched case."""

    # The wrapper makes this class anew for every instance and never frees it, and each time it
    # drops a reference to this module's globals that it does not own. Two functions hold two:
    # with one, the globals are freed too early and the host can crash at its exit.
    def __init__(self, **kwargs):
        super().__init__(**kwargs)

    def __repr__(self):
        return f"<{self.modelName} {self.instance_name}>"
