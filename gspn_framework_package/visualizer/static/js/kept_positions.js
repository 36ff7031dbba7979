// The positions that nodes were dragged to, stored in this browser for this net.

export class KeptPositions {
  constructor(hash) {
    this.key = `gspn-layout-${hash}`;
  }

  /** The stored positions: a map from names to [x, y]. */
  read() {
    try {
      const kept = Object.entries(JSON.parse(localStorage.getItem(this.key)) || {});
      return new Map(
        kept.filter(
          ([, point]) => Array.isArray(point) && point.length === 2 && point.every(Number.isFinite),
        ),
      );
    } catch {
      return new Map();
    }
  }

  write(nodes) {
    const moved = nodes
      .filter((node) => node.moved)
      .map((node) => [node.name, node.home.map(Math.round)]);
    try {
      if (moved.length) localStorage.setItem(this.key, JSON.stringify(Object.fromEntries(moved)));
      else localStorage.removeItem(this.key);
    } catch {
      /* private browsing: kept until the page is closed */
    }
  }

  forget() {
    this.write([]);
  }
}
