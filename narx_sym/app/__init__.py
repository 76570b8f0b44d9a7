"""The live form: a local page over a workbench that knows nothing of pages."""
