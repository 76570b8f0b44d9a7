"""narx_sym: hysteretic actuators as symbolic NARX models, from measurements to a running compensator.

The rooms, each of which imports only rooms that stand before it:

- `symbolic`: y[k] and the shift operator; `recursion` is the ordered list of update equations that everything is
- `models`: NARX models and pools, section 3 of the paper, physical effects and how a model takes them up
- `files`: model files, journals and parallel loops
- `inversion`: section 4 of the paper, from a model to its compensation law
- `engines`: recursions as functions over arrays
- `data`: records and simulated plants; they know no model
- `codegen`: recursions as source for other places
- `fit`: section 2 of the paper; simulation, estimation, selection, laws run over a reference
- `sklearn`: the identification as a scikit-learn estimator; loaded only when it is imported
- `diagnosis`: which physical effect is missing
- `tasks`: what people ask for, one function for each, shared by all that follow
- `report`, `app`, `cli`: what people look at and type

`__init__.pyi` lists the public names; each is loaded when it is first used.
"""

import lazy_loader

__version__ = "0.2.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
