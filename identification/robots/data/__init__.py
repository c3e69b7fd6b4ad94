"""Tables of numbers of the built-in robots; read through `importlib.resources` by `identification.robots`."""
