"""Fills the template database with the rows of data/*.csv, from which the tasks draw their fields too."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path

from django.contrib.auth import get_user_model
from django.core.management import call_command

from examples.django_admin.shop.models import Comment, Order, Product
from examples.django_admin.shop.urls import ADMIN

DATA = Path(__file__).parent.parent / "data"


def rows(name: str) -> Iterator[dict[str, str]]:
    """The rows of a CSV file of the data."""
    with (DATA / f"{name}.csv").open(newline="", encoding="utf-8") as file:
        yield from csv.DictReader(file)


def fill() -> None:
    """Make the tables and their rows."""
    call_command("migrate", run_syncdb=True, verbosity=0, interactive=False)
    get_user_model().objects.create_superuser(ADMIN, "admin@example.test", "admin")
    Product.objects.bulk_create(Product(name=row["product"], price=row["price"]) for row in rows("products"))
    Order.objects.bulk_create(
        Order(number=row["order"], customer=row["customer"], status=row["status"].lower()) for row in rows("orders")
    )
    Comment.objects.bulk_create(Comment(author=row["author"], text=row["text"]) for row in rows("comments"))
