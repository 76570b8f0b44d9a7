"""The parts of the report and of the live page, one file each; `registry` finds them."""
