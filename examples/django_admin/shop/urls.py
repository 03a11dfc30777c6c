"""The admin, a page that begins an episode, and the checks of success, which read the database."""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal

from django.contrib import admin
from django.contrib.auth import get_user_model, login
from django.db.models import Model
from django.http import HttpRequest, HttpResponse, HttpResponseRedirect
from django.urls import path

from examples.django_admin.shop import databases
from examples.django_admin.shop.models import Comment, Order, Product, Visit

ADMIN = "admin"  # the user that an episode is logged in as
Values = dict[str, str]


def begin(request: HttpRequest, episode: str) -> HttpResponse:
    """Make the episode's database, log in, and go to the admin."""
    databases.begin(episode)
    with databases.using(episode):
        user = get_user_model().objects.get(username=ADMIN)
        login(request, user, backend="django.contrib.auth.backends.ModelBackend")
    response = HttpResponseRedirect("/admin/")
    response.set_cookie(databases.COOKIE, episode, httponly=True)
    return response


def user_added(values: Values) -> bool:
    """A user with these names and this password is there, and no other new one."""
    users = get_user_model().objects.exclude(username=ADMIN)
    user = users.filter(username=values["username"], first_name=values["first"], last_name=values["last"]).first()
    return user is not None and users.count() == 1 and user.check_password(values["password"])


def price_changed(values: Values) -> bool:
    """The product has the price, and all others have theirs."""
    return _changed(Product, "name", "price") == {values["product"]: Decimal(values["price"])}


def order_shipped(values: Values) -> bool:
    """The order is shipped, and all others are as before."""
    return _changed(Order, "number", "status") == {values["order"]: Order.Status.SHIPPED}


def comment_deleted(values: Values) -> bool:
    """The comment is gone, and no other."""
    return _changed(Comment, "author", "text") == {values["author"]: None}


def match_opened(values: Values) -> bool:
    """The order was opened from the filtered list, and it was the first one."""
    visits = list(Visit.objects.values_list("order", "filters"))
    return visits == [(values["order"], f"status__exact={values['status'].lower()}")]


def _changed(model: type[Model], key: str, column: str) -> dict[object, object]:
    """What the episode has changed: key -> new value of the column, None for a row that is gone."""
    rows = dict(model.objects.values_list(key, column))
    with databases.using(databases.TEMPLATE):
        before = dict(model.objects.values_list(key, column))
    return {one: rows.get(one) for one in before.keys() | rows.keys() if before.get(one) != rows.get(one)}


CHECKS: dict[str, Callable[[Values], bool]] = {
    "add_user": user_added,
    "change_price": price_changed,
    "ship_order": order_shipped,
    "delete_comment": comment_deleted,
    "open_match": match_opened,
}


def check(request: HttpRequest, task: str, episode: str) -> HttpResponse:
    """200 if the episode's database is as the goal wants it, 409 if not."""
    with databases.using(episode):
        return HttpResponse(status=200 if CHECKS[task](request.GET.dict()) else 409)


urlpatterns = [
    path("admin/", admin.site.urls),
    path("begin/<str:episode>/", begin),
    path("check/<str:task>/<str:episode>/", check),
]
