// SPDX-License-Identifier: MIT
// Bound to every memory: no access beyond its last word.
module ram_proof #(
    parameter int unsigned ADDR_BITS = 4,
    parameter int unsigned DEPTH = 16
) (
    input logic                 clk_i,
    input logic                 we_i,
    input logic [ADDR_BITS-1:0] waddr_i,
    input logic                 re_i,
    input logic [ADDR_BITS-1:0] raddr_i
);

  always_ff @(posedge clk_i) begin
    if (we_i) assert (32'(waddr_i) < DEPTH);
    if (re_i) assert (32'(raddr_i) < DEPTH);
  end

endmodule
