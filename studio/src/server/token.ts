// The token that the server asks for. This tab alone keeps it: a cookie would go to every server of the machine.

const KEY = "neuroanimator token";

/** Take the token out of the page's address, where the server's own line has it; what stands beside it is asked as usual. */
export function takeToken(): void {
  const said = new URLSearchParams(location.hash.slice(1));
  const found = said.get("token");
  if (found !== null) {
    sessionStorage.setItem(KEY, found);
    said.delete("token");
    const asked = [location.search.slice(1), said.toString()].filter((part) => part !== "").join("&");
    history.replaceState(null, "", location.pathname + (asked ? `?${asked}` : ""));
  }
}

/** Return the token of this tab, or an empty text. */
function token(): string {
  try {
    return sessionStorage.getItem(KEY) ?? "";
  } catch {
    return ""; // a page in a file may have no storage
  }
}

/** Fetch from the page's own server; the error is its line, or names the address. */
export async function fetchOwn(address: string | URL, request: RequestInit = {}): Promise<Response> {
  const said = token();
  const headers = new Headers(request.headers);
  if (said) {
    headers.set("X-Token", said);
  }
  const response = await fetch(address, { ...request, headers });
  if (!response.ok) {
    const answer = (await response.json().catch(() => ({}))) as Record<string, unknown>;
    const path = new URL(address, document.baseURI).pathname;
    throw new Error(String(answer["error"] ?? `${path}: ${response.status} ${response.statusText}`));
  }
  return response;
}

/** Open a socket to the page's own server. */
export function openSocket(address: URL): WebSocket {
  return new WebSocket(address, [`token.${token()}`]);
}
