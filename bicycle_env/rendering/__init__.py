"""Pictures of an episode; imported only when ``render()`` is called, needs ``pip install "bicycle-env[render]"``."""
