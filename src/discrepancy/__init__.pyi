"""The public names, listed once."""

from .data.reading import InputError as InputError
from .plan_experiment import Plan as Plan
from .plan_experiment import plan as plan
from .policy import SearchPolicy as SearchPolicy
from .report.figures import plot_gap as plot_gap
from .report.search_page import write_report as write_report
from .results import SearchResult as Finding
from .results import SearchResult as SearchResult
from .search import find as find
from .wording import describe_rejection as describe_rejection
from .wording import describe_search as describe_search

__version__: str
__all__ = ["Finding", "InputError", "Plan", "SearchPolicy", "SearchResult", "__version__", "find", "plan"]
