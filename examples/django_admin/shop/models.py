"""What the shop stores besides its users: products, orders, comments."""

from __future__ import annotations

from django.db import models


class Product(models.Model):
    name = models.CharField(max_length=60, unique=True)
    price = models.DecimalField(max_digits=8, decimal_places=2)

    class Meta:
        ordering = ("name",)

    def __str__(self) -> str:
        return str(self.name)


class Order(models.Model):
    class Status(models.TextChoices):
        NEW = "new", "New"
        PAID = "paid", "Paid"
        SHIPPED = "shipped", "Shipped"
        CANCELLED = "cancelled", "Cancelled"

    number = models.CharField(max_length=12, unique=True)
    customer = models.CharField(max_length=60)
    status = models.CharField(max_length=12, choices=Status.choices)

    class Meta:
        ordering = ("number",)

    def __str__(self) -> str:
        return str(self.number)


class Visit(models.Model):
    """An order was opened in the admin: what a check of success reads where nothing else changes."""

    order = models.CharField(max_length=12)
    filters = models.CharField(max_length=200)  # of the list from which it was opened


class Comment(models.Model):
    author = models.CharField(max_length=60, unique=True)
    text = models.CharField(max_length=200)

    class Meta:
        ordering = ("author",)

    def __str__(self) -> str:
        return str(self.author)
