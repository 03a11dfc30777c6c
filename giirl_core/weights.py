"""The parameters of a net as versioned bytes with a checksum, for checkpoints and for messages."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Weights:
    """The parameters of a net after one learner step, as safetensors bytes."""

    version: int  # learner step that produced them
    blob: bytes
    digest: str  # sha256 of blob, hex

    @classmethod
    def with_digest(cls, version: int, blob: bytes) -> Weights:
        """Weights with the checksum of `blob` computed."""
        return cls(version=version, blob=blob, digest=hashlib.sha256(blob).hexdigest())

    def check(self) -> None:
        """Raise ValueError if the checksum does not match `blob`."""
        if (found := hashlib.sha256(self.blob).hexdigest()) != self.digest:
            raise ValueError(
                f"weights version {self.version} are corrupt: sha256 {found[:12]}, wanted {self.digest[:12]}"
            )
