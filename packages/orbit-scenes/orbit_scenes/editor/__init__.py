"""Editor of scenes in the browser, on the viewer's guarded server."""
