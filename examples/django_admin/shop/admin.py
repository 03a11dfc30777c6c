"""The admin's pages of the shop."""

from __future__ import annotations

from typing import Any

from django.contrib import admin
from django.http import HttpRequest, HttpResponse

from examples.django_admin.shop.models import Comment, Order, Product, Visit

admin.site.enable_nav_sidebar = False  # every page would repeat the index


@admin.register(Product)
class ProductAdmin(admin.ModelAdmin):
    list_display = ("name", "price")


@admin.register(Order)
class OrderAdmin(admin.ModelAdmin):
    list_display = ("number", "customer", "status")
    list_display_links = ("number", "customer")
    list_filter = ("status",)
    search_fields = ("number",)
    list_per_page = 25  # of 80 orders

    def change_view(self, request: HttpRequest, object_id: str, *args: Any, **kwargs: Any) -> HttpResponse:
        """The page of an order; notes that it was opened."""
        order = self.get_object(request, object_id)
        if request.method == "GET" and order is not None:
            Visit.objects.create(order=order.number, filters=request.GET.get("_changelist_filters", ""))
        return super().change_view(request, object_id, *args, **kwargs)


@admin.register(Comment)
class CommentAdmin(admin.ModelAdmin):
    list_display = ("author", "text")
