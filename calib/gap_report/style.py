"""The style sheet of a report: readable in light and dark, and on paper."""

STYLE = """
:root { color-scheme: light dark; --ink:#1b2733; --soft:#5c6b78; --grid:#e1e6eb; --page:#fff; --card:#f6f8fa;
 --before:#c2410c; --after:#0f766e; --model:#1d4ed8; --floor:#7c8794; }
@media (prefers-color-scheme: dark) { :root { --ink:#e6ebf0; --soft:#9aa8b5; --grid:#2b3641; --page:#12181e;
 --card:#1a222a; --before:#fb923c; --after:#2dd4bf; --model:#7cabff; --floor:#8b98a5; } }
@media print { :root { --ink:#000; --soft:#333; --grid:#ddd; --page:#fff; --card:#fff; --before:#c2410c;
 --after:#0f766e; --model:#1d4ed8; --floor:#7c8794; } section, figure { break-inside: avoid; } }
* { box-sizing: border-box; }
body { margin:0 auto; max-width:960px; padding:24px 20px 60px; background:var(--page); color:var(--ink);
 font:15px/1.5 system-ui, sans-serif; }
h1 { font-size:24px; margin:0 0 4px; } h2 { font-size:18px; margin:34px 0 6px; }
p { margin:6px 0 10px; } .soft { color:var(--soft); } code { font-size:13px; overflow-wrap:anywhere; }
.verdict { border-left:5px solid var(--model); background:var(--card); padding:12px 16px; margin:16px 0; }
.verdict b { font-size:17px; } .wide { overflow-x:auto; }
figure { margin:10px 0; } .row { display:flex; flex-wrap:wrap; gap:14px; }
table { border-collapse:collapse; margin:8px 0; font-size:14px; width:100%; }
th, td { text-align:left; padding:4px 10px 4px 0; border-bottom:1px solid var(--grid); vertical-align:top; }
th { color:var(--soft); font-weight:600; } .number { white-space:nowrap; font-variant-numeric:tabular-nums; }
.meter { display:inline-block; min-width:64px; padding:0 6px; background:linear-gradient(to right,
 color-mix(in srgb, var(--before) 35%, transparent) calc(var(--level) * 100%), transparent 0); }
svg { max-width:100%; height:auto; } svg text { fill:var(--soft); font:11px system-ui, sans-serif; }
svg .title { fill:var(--ink); font-size:12.5px; font-weight:600; } svg .legend { fill:var(--ink); }
svg .grid { stroke:var(--grid); stroke-width:1; fill:none; }
"""
