"""An application in the browser over the public interface: `skhyst app`, extra `app`."""

from ._suggestion import Suggestion, suggest_model

__all__ = ["Suggestion", "suggest_model"]
