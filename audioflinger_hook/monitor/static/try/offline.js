// Keeps the page for times without a network. The lines before, which the server adds, set FILES, which the page
// needs to start, MORE, its other files, and VERSION.

const NAME = `try-${VERSION}`;

self.oninstall = (event) => event.waitUntil((async () => {
  const kept = await caches.open(NAME);
  await kept.addAll(FILES.map((file) => new Request(file, { cache: "no-cache" })));
  await self.skipWaiting();
})());

self.onactivate = (event) => event.waitUntil((async () => {
  for (const name of await caches.keys()) {
    if (name.startsWith("try-") && name !== NAME) await caches.delete(name);
  }
  await self.clients.claim();
})());

/** The page is in use: load what other profiles and scenes need, unless the browser saves data. */
self.onmessage = (event) => event.waitUntil((async () => {
  if (navigator.connection?.saveData) return;
  for (const file of MORE) await answer(new Request(file)).catch(() => {}); // the next use tries again
})());

self.onfetch = (event) => {
  const { request } = event;
  if (request.method === "GET" && request.url.startsWith(self.registration.scope)) event.respondWith(answer(request));
};

/** What is kept, else what the network gives, which is kept from then on. */
async function answer(request) {
  const kept = await caches.open(NAME), found = await kept.match(request, { ignoreSearch: true });
  if (found) return found;
  const fresh = await fetch(request.url, { cache: "no-cache" }); // not what an earlier version left
  if (fresh.ok) await kept.put(request, fresh.clone());
  return fresh;
}
