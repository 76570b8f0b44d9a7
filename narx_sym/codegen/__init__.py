"""One step of a recursion as source for other places."""
