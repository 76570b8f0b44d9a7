"""Machine code by LLVM: expressions, loops over samples, tangents beside them, many parameter sets side by side."""
