"""The public names, listed once."""

from .data.reading import InputError as InputError
from .finding import Finding as Finding
from .finding import find as find
from .plan_experiment import Plan as Plan
from .plan_experiment import plan as plan
from .policy import SearchPolicy as SearchPolicy

__version__: str
__all__ = ["Finding", "InputError", "Plan", "SearchPolicy", "__version__", "find", "plan"]
