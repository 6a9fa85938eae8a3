"""An application in the browser over the public interface: `skhyst app`, extra `app`."""

from ._suggestion import DEVICES, Suggestion, suggest_model

__all__ = ["DEVICES", "Suggestion", "suggest_model"]
