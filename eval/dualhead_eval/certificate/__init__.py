"""A verdict on coordination that runs beside a robot, with bounds that hold at all times."""

from dualhead_eval.certificate.certificate import CoordinationCertificate

__all__ = ["CoordinationCertificate"]
