// SPDX-License-Identifier: MIT
// A memory that the pipeline fills with rows, packed to one stream of bits, and the host reads.
//
// A row goes through a register first: to select what is in it and to place it takes a cycle each.
module pearl_result_bank
  import pearl_pkg::index_bits;
#(
    parameter int unsigned ROW_BITS = 48,
    parameter int unsigned DATA_WL = 32,
    parameter int unsigned WORDS = 3,
    localparam int unsigned ADDR_BITS = index_bits(WORDS)
) (
    input  logic                clk_i,
    input  logic                rst_ni,
    input  logic                start_i,
    input  logic                valid_i,
    input  logic                last_i,
    input  logic [ROW_BITS-1:0] row_i,
    // Every word has been written.
    output logic                done_o,

    input  logic                 host_re_i,
    input  logic [ADDR_BITS-1:0] host_addr_i,
    output logic [  DATA_WL-1:0] host_rdata_o
);

  logic we, valid_q, last_q;
  logic [ ROW_BITS-1:0] row_q;
  logic [ADDR_BITS-1:0] waddr;
  logic [  DATA_WL-1:0] wdata;

  always_ff @(posedge clk_i) begin
    valid_q <= valid_i;
    last_q  <= last_i;
    row_q   <= row_i;
  end

  pearl_packer #(
      .ROW_BITS(ROW_BITS),
      .DATA_WL (DATA_WL),
      .WORDS   (WORDS)
  ) u_packer (
      .clk_i,
      .rst_ni,
      .start_i,
      .valid_i(valid_q),
      .last_i (last_q),
      .row_i  (row_q),
      .we_o   (we),
      .waddr_o(waddr),
      .wdata_o(wdata),
      .done_o
  );

  pearl_ram #(
      .WIDTH(DATA_WL),
      .DEPTH(WORDS)
  ) u_ram (
      .clk_i,
      .we_i   (we),
      .waddr_i(waddr),
      .wdata_i(wdata),
      .re_i   (host_re_i),
      .raddr_i(host_addr_i),
      .rdata_o(host_rdata_o)
  );

endmodule
