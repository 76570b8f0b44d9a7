"""placeholder"""
from typing import Any
Experiment = Any
def propose(*a: Any) -> Any: return None
