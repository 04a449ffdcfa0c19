"""Pictures of an episode; imported only when ``render()`` is called, needs pygame-ce, of the extra ``render``."""
