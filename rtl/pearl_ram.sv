// SPDX-License-Identifier: MIT
// A memory with one write port and one read port, in the form that infers block RAM and, where a family
// has one, its output register.
//
// A word that is read stands at the output READ_LATENCY cycles later and stays until the next one: in the
// first cycle it comes out of the memory, in the second, which oe_i may put off, it goes to the output.
// Reading what is written in the same cycle gives the old word; nothing in the backbone does that within
// a step.
module pearl_ram
  import pearl_pkg::index_bits;
#(
    parameter int unsigned WIDTH = 32,
    parameter int unsigned DEPTH = 16,
    localparam int unsigned ADDR_BITS = index_bits(DEPTH)
) (
    input  logic                 clk_i,
    input  logic                 we_i,
    input  logic [ADDR_BITS-1:0] waddr_i,
    input  logic [    WIDTH-1:0] wdata_i,
    input  logic                 re_i,
    input  logic [ADDR_BITS-1:0] raddr_i,
    input  logic                 oe_i,
    output logic [    WIDTH-1:0] rdata_o
);

  // An address has a bit even where there is one word only.
  localparam int unsigned WORDS = DEPTH > 1 ? DEPTH : 2;
  // Public, because a simulation's host may move whole memories at once instead of word by word.
  logic [WIDTH-1:0] mem[WORDS]  /* verilator public_flat_rw */;
  logic [WIDTH-1:0] rdata_q, out_q;

  always_ff @(posedge clk_i) begin
    if (we_i) mem[waddr_i] <= wdata_i;
    if (re_i) rdata_q <= mem[raddr_i];
    if (oe_i) out_q <= rdata_q;
  end

  assign rdata_o = out_q;

endmodule
