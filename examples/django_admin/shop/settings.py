"""Django's settings of the shop: the admin as it comes, and a database for each episode."""

from __future__ import annotations

import tempfile
from pathlib import Path

FOLDER = Path(tempfile.mkdtemp(prefix="giirl-shop-"))  # of the databases; serve.py removes it
TEMPLATE = FOLDER / "template.sqlite3"  # what every episode begins with
SQLITE = {
    "ENGINE": "django.db.backends.sqlite3",
    "OPTIONS": {"init_command": "PRAGMA synchronous=OFF; PRAGMA journal_mode=MEMORY;"},
}

SECRET_KEY = "only-for-this-example-on-loopback"
DEBUG = False
ALLOWED_HOSTS = ["127.0.0.1"]
ROOT_URLCONF = "examples.django_admin.shop.urls"
DEFAULT_AUTO_FIELD = "django.db.models.AutoField"
DATABASES = {"default": {**SQLITE, "NAME": str(TEMPLATE)}}
DATABASE_ROUTERS = ["examples.django_admin.shop.databases.EpisodeRouter"]
SESSION_ENGINE = "django.contrib.sessions.backends.signed_cookies"
PASSWORD_HASHERS = ["django.contrib.auth.hashers.MD5PasswordHasher"]  # fast: these passwords protect nothing
AUTH_PASSWORD_VALIDATORS: list[dict[str, str]] = []
USE_TZ = True
STATIC_URL = "static/"
INSTALLED_APPS = [
    "django.contrib.admin",
    "django.contrib.auth",
    "django.contrib.contenttypes",
    "django.contrib.sessions",
    "django.contrib.messages",
    "django.contrib.staticfiles",
    "examples.django_admin.shop",
]
MIDDLEWARE = [
    "examples.django_admin.shop.databases.episode_middleware",
    "django.contrib.sessions.middleware.SessionMiddleware",
    "django.middleware.common.CommonMiddleware",
    "django.middleware.csrf.CsrfViewMiddleware",
    "django.contrib.auth.middleware.AuthenticationMiddleware",
    "django.contrib.messages.middleware.MessageMiddleware",
]
TEMPLATES = [
    {
        "BACKEND": "django.template.backends.django.DjangoTemplates",
        "APP_DIRS": True,
        "OPTIONS": {
            "context_processors": [
                "django.template.context_processors.request",
                "django.contrib.auth.context_processors.auth",
                "django.contrib.messages.context_processors.messages",
            ]
        },
    }
]
